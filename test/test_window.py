# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The window matcher against its definition in plain numpy, known shifts, and Tsukuba and Venus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from middlebury2001 import bad, matched, scene

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.selection.float_costs import median_filter
from stereo_depth_ros.matching.window.fixed_window import WindowMatcher

UNCHECKED: dict[str, Any] = {"num_disparities": 32, "uniqueness_ratio": 0.0, "speckle_size": 0}
COSTS = ("sad", "ssd", "zsad", "zssd", "ncc", "zncc")


def shifted_pair(height: int, width: int, shift: int, rows: int = 0, seed: int = 1) -> tuple[U8, U8]:
    """Noise seen twice: the left pixel (y, x) is the right pixel (y + rows, x - shift)."""
    rng = np.random.default_rng(seed)
    right = rng.integers(0, 200, (height, width)).astype(np.uint8)
    return np.roll(right, (-rows, shift), (0, 1)), right


def check_result(result: MatchResult, shape: tuple[int, int]) -> None:
    assert result.disparity_px.dtype == np.float32 and result.disparity_px.shape == shape
    assert result.reasons.dtype == np.uint8 and result.reasons.shape == shape
    np.testing.assert_array_equal(result.reasons == 0, np.isfinite(result.disparity_px))
    confidence = result.confidence
    assert confidence is not None and confidence.dtype == np.float32 and confidence.shape == shape
    assert confidence.min() >= 0 and confidence.max() <= 1 and not confidence[result.reasons != 0].any()


def window_cost(cost: str, a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> float:
    """Definition of the dissimilarity of two windows."""
    if cost.startswith("z"):
        a, b = a - a.mean(), b - b.mean()
    if cost.endswith("sad"):
        return float(np.abs(a - b).mean())
    if cost.endswith("ssd"):
        return float(((a - b) ** 2).mean())
    power = float((a**2).sum() * (b**2).sum())
    return 1 - float((a * b).sum()) / power**0.5 if power > 1e-6 else np.inf


def plain_costs(left: U8, right: U8, config: MatchingConfig) -> F32:
    """Costs (H, W, D) by the definition, disparities ascending, inf outside the right image."""
    height, width = left.shape
    half = config.correlation_window_size // 2
    costs = np.full((height, width, config.num_disparities), np.inf, np.float32)
    for y, x, index in np.ndindex(costs.shape):
        d = index + config.min_disparity
        if not 0 <= x - d < width:
            continue
        begin, end = max(x - half, 0, d), min(x + half + 1, width, width + d)
        for v in range(-config.vertical_search, config.vertical_search + 1):
            top, bottom = max(y - half, 0, -v), min(y + half + 1, height, height - v)
            if top < bottom:
                a = left[top:bottom, begin:end].astype(float)
                b = right[top + v : bottom + v, begin - d : end - d].astype(float)
                costs[y, x, index] = min(costs[y, x, index], np.float32(window_cost(config.window_cost, a, b)))
    return costs


def plain_disparities(costs: F32, config: MatchingConfig) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Winner and sub-pixel fit in 1/16 px, and where the winner is clear beyond rounding."""
    disparity_x16 = np.zeros(costs.shape[:2])
    clear = np.zeros(costs.shape[:2], np.bool_)
    for y, x in np.ndindex(disparity_x16.shape):
        row = costs[y, x].astype(float)
        best = int(row.argmin())
        disparity_x16[y, x] = 16 * (best + config.min_disparity)
        if 0 < best < row.size - 1:
            before, after = row[best - 1] - row[best], row[best + 1] - row[best]
            span = max(before, after) if config.window_cost.endswith("sad") else before + after
            if np.isfinite(span) and span > 0:
                disparity_x16[y, x] += 8 * (before - after) / span
        clear[y, x] = np.sort(row)[1] > row[best] + 1e-4
    return disparity_x16, clear


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize(("low", "vertical"), [(0, 0), (-13, 0), (-3, 1)])
def test_window_of_each_cost_is_the_definition(
    cost: str, low: int, vertical: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "stereo_depth_ros.matching.window.fixed_window.median_filter",
        lambda disparity_x16, reasons, side: disparity_x16,
    )
    left, right = shifted_pair(7, 41, 6, seed=3)
    left = np.clip(left * 0.8 + 30 + np.random.default_rng(4).normal(0, 6, left.shape), 0, 255).astype(np.uint8)
    matcher = WindowMatcher(
        MatchingConfig(
            min_disparity=low, window_cost=cost, vertical_search=vertical, correlation_window_size=3, **UNCHECKED
        )
    )
    result = matcher.match(left, right)
    check_result(result, left.shape)
    expected, clear = plain_disparities(plain_costs(left, right, matcher.config), matcher.config)
    assert clear.mean() > 0.8 and (result.reasons == 0).all()
    # Half a step of rounding; costs are float32.
    np.testing.assert_array_less(np.abs(result.disparity_px * 16 - expected)[clear], 0.51)


def test_truncated_sad_is_independent_of_large_differences() -> None:
    left, right = shifted_pair(30, 80, 9)
    spoiled = np.where(np.random.default_rng(2).random(left.shape) < 0.4, 255, left).astype(np.uint8)

    def disparities(image: U8, bound: int) -> F32:
        fields = {**UNCHECKED, "correlation_window_size": 3, "max_difference": bound}
        return create_matcher("window", **fields).match(image, right).disparity_px

    plain, bounded = (np.mean(np.abs(disparities(spoiled, bound) - 9)[:, 20:] <= 0.5) for bound in (0, 10))
    assert bounded > plain + 0.1
    np.testing.assert_array_equal(disparities(left, 199), disparities(left, 0))  # no difference is larger than 199


@pytest.mark.parametrize("side", [1, 3, 9, 21])
def test_any_odd_window_finds_a_shift(side: int) -> None:
    left, right = shifted_pair(33, 90, 17)
    result = create_matcher("window", correlation_window_size=side, **UNCHECKED).match(left, right)
    check_result(result, left.shape)
    inside = result.disparity_px[:, 17 + side :]
    assert np.mean(np.abs(inside - 17) <= 0.5) > (0.5 if side == 1 else 0.999)  # one gray value has many matches


@pytest.mark.parametrize("cost", COSTS)
def test_vertical_search_finds_row_offsets(cost: str) -> None:
    left, right = shifted_pair(40, 90, 8, rows=-2)
    inner = np.s_[6:-6, 16:-6]
    for vertical, correct in ((2, True), (1, False)):
        fields = {**UNCHECKED, "correlation_window_size": 7, "vertical_search": vertical}
        result = create_matcher("window", window_cost=cost, **fields).match(left, right)
        right_ones = np.abs(result.disparity_px[inner] - 8) <= 0.5
        assert right_ones.all() if correct else right_ones.mean() < 0.3


def test_zero_mean_costs_ignore_gray_offset_and_zncc_contrast() -> None:
    left, right = shifted_pair(31, 88, 11)
    darker, flatter = (left * 0.5).astype(np.uint8), (left * 0.5 + 100).astype(np.uint8)
    for image, cost in (
        (flatter, "zncc"),
        (darker, "ncc"),
        (left + np.uint8(50), "zsad"),
        (left + np.uint8(50), "zssd"),
    ):
        result = create_matcher("window", window_cost=cost, correlation_window_size=9, **UNCHECKED).match(image, right)
        np.testing.assert_allclose(result.disparity_px[5:-5, 20:-5], 11, atol=0.5)


@pytest.mark.parametrize("low", [5, -40])
def test_pixels_without_a_candidate_are_border(low: int) -> None:
    shift = low + 12
    left, right = shifted_pair(23, 101, shift)
    result = create_matcher("window", min_disparity=low, correlation_window_size=5, **UNCHECKED).match(left, right)
    border = np.zeros(left.shape, np.bool_)
    border[:, : max(0, low)] = border[:, 101 + min(0, low + 31) :] = True
    assert border.any()
    np.testing.assert_array_equal(result.reasons, np.where(border, Reason.BORDER, 0))
    seen = slice(20, None) if shift > 0 else slice(None, shift - 20)
    np.testing.assert_allclose(result.disparity_px[:, seen], shift, atol=0.5)


def test_windows_without_contrast_have_no_correlation() -> None:
    left, right = shifted_pair(30, 90, 8)
    left[10:20, 40:60] = 77
    result = create_matcher("window", window_cost="zncc", correlation_window_size=5, **UNCHECKED).match(left, right)
    flat = np.zeros(left.shape, np.bool_)
    flat[12:18, 42:58] = True
    np.testing.assert_array_equal(result.reasons, np.where(flat, Reason.TEXTURE, 0))


def test_checks_reject_repeated_texture_and_occlusions() -> None:
    _, right = shifted_pair(40, 120, 0)
    left = np.roll(right, 4, 1)
    left[10:30, 60:90] = right[10:30, 45:75]  # 15 px: in front, with 11 occluded columns to its left
    fields = {**UNCHECKED, "correlation_window_size": 5}
    checked = create_matcher("window", **fields, disp12_max_diff=1).match(left, right)
    counts = checked.reason_counts()
    occluded = checked.reasons[14:26, 52:57]
    assert (occluded == Reason.LEFT_RIGHT).mean() > 0.9
    assert counts["LEFT_RIGHT"] < 900 and counts["UNIQUENESS"] == 0
    repeated = np.tile(right[:, :8], (1, 15))
    unique = create_matcher("window", **{**fields, "uniqueness_ratio": 5.0}).match(np.roll(repeated, 3, 1), repeated)
    assert (unique.reasons[:, 14:] == Reason.UNIQUENESS).all()


def test_speckles_are_removed() -> None:
    left, right = shifted_pair(40, 120, 4)
    left[18:24, 70:76] = right[18:24, 50:56]
    fields = {**UNCHECKED, "correlation_window_size": 3, "speckle_range": 1}
    kept, cleaned = (
        create_matcher("window", **{**fields, "speckle_size": size}).match(left, right) for size in (0, 60)
    )
    assert abs(kept.disparity_px[21, 73] - 20) < 1 and kept.reason_counts()["SPECKLE"] == 0
    assert cleaned.reasons[21, 73] == Reason.SPECKLE
    check_result(cleaned, left.shape)


def test_median_is_that_of_the_valid_pixels() -> None:
    rng = np.random.default_rng(5)
    disparity_x16 = rng.integers(-300, 300, (17, 26)).astype(np.int16)
    reasons = (rng.random(disparity_x16.shape) < 0.4).astype(np.uint8)
    for side in (3, 7, 31):
        filtered = median_filter(disparity_x16, reasons, side)
        half = side // 2
        for y, x in np.ndindex(disparity_x16.shape):
            near = np.s_[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
            values = np.sort(disparity_x16[near][reasons[near] == 0])
            assert filtered[y, x] == (disparity_x16[y, x] if reasons[y, x] else values[(values.size - 1) // 2])


def test_same_bytes_on_any_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = shifted_pair(211, 97, 7)
    left = cv2.GaussianBlur(left, (0, 0), 1)
    found = []
    for cores in (1, 3):
        monkeypatch.setattr(parallel, "core_count", lambda cores=cores: cores)
        matcher = create_matcher("window", correlation_window_size=7, window_cost="zncc", disp12_max_diff=1)
        result = matcher.match(left, right)
        assert result.confidence is not None
        found.append(result.disparity_px.tobytes() + result.reasons.tobytes() + result.confidence.tobytes())
    assert found[0] == found[1]


def test_refused() -> None:
    with pytest.raises(
        ConfigError, match="max_difference = 20 truncates sad, not ncc: use the cost sad, or no truncation"
    ):
        create_matcher("window", window_cost="ncc", max_difference=20)
    with pytest.raises(ConfigError, match=r"disparities 2040\.\.2103 are searched"):
        create_matcher("window", min_disparity=2040)
    with pytest.raises(ImageError, match="needs 46 x 15 px"):
        create_matcher("window", num_disparities=32).match(*shifted_pair(40, 45, 3))
    out = np.empty((40, 60), np.float32)
    assert create_matcher("window", num_disparities=32).match(*shifted_pair(40, 60, 3), out).disparity_px is out


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "limit"), [("tsukuba", 7.0), ("venus", 6.0)])
def test_real_scenes(stereo_data: Path, name: str, limit: float) -> None:
    result = matched("window", name, stereo_data, correlation_window_size=15, max_difference=20).result
    assert result.valid_fraction == 1
    assert bad(result.disparity_px, scene(name, stereo_data)) <= limit

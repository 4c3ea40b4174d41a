# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptive windows against their definition in plain numpy, known sub-pixel shifts, and Tsukuba and Venus."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adaptive_window_definition import grown_window, warped_pair
from middlebury2001 import bad, part, scene

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F32, F64, MatchResult, Reason
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.window import adaptive_window, adaptive_window_kernel

UNCHECKED: dict[str, Any] = {
    "num_disparities": 32,
    "uniqueness_ratio": 0.0,
    "speckle_size": 0,
    "correlation_window_size": 9,
}


def check_result(result: MatchResult, shape: tuple[int, int]) -> None:
    assert result.disparity_px.dtype == np.float32 and result.disparity_px.shape == shape
    np.testing.assert_array_equal(result.reasons == 0, np.isfinite(result.disparity_px))
    assert result.confidence is not None
    assert (result.confidence >= 0).all() and (result.confidence <= 1).all()
    assert (result.confidence[result.reasons != 0] == 0).all()


def plain_disparity(maps: list[F64], y: int, x: int) -> tuple[float, list[int], bool]:
    """Disparity after one iteration, extents of the pixel's own window, and whether another surface's counts."""
    before = maps[2]
    own = before[y, x]
    estimate, extent = grown_window(maps, y, x, own)
    found = [(np.inf if estimate is None else estimate.surprise, own, 0.0 if estimate is None else estimate.increment)]
    away = adaptive_window.SURFACE_DISTANCE
    for row, column in ((y - away, x), (y + away, x), (y, x - away), (y, x + away)):
        if 0 <= row < before.shape[0] and 0 <= column < before.shape[1] and abs(before[row, column] - own) > 1:
            other, _ = grown_window(maps, y, x, before[row, column])
            if other is not None:
                found.append((other.surprise, before[row, column], other.increment))
    _, center, increment = min(found, key=lambda one: one[0])
    return center + float(np.clip(increment, -1, 1)), extent, center != own


def refined(left: F32, right: F32, before: F32) -> F32:
    slope = np.zeros_like(right)
    slope[:, 1:-1] = (right[:, 2:] - right[:, :-2]) / 2
    after = np.empty_like(before)
    tables = (*adaptive_window_kernel.distances(), *adaptive_window_kernel.scratch(1))
    adaptive_window._refine_rows(0, len(left), (left, right, slope, before), *tables, after)
    return after


def test_one_iteration_is_the_definition() -> None:
    disparity = np.full((33, 74), 7.3, np.float32)
    disparity[:, 36:] = 12.6
    left, right = (image.astype(np.float32) for image in warped_pair(33, 74, disparity))
    before = np.round((disparity + np.random.default_rng(3).normal(0, 0.2, disparity.shape)) * 16) / 16
    before[8:25, 34:39] = 12.5  # the step is not where it should be
    before = before.astype(np.float32)
    before[20:23, 50:52] = np.nan
    after = refined(left, right, before)
    np.testing.assert_array_equal(np.isnan(after), np.isnan(before))
    maps = [image.astype(np.float64) for image in (left, right, before)]
    sizes, taken_over = set(), 0
    rows = [0, 4, 9, 16, 21, 27, 32] * 9
    for y, x in [*zip(rows, range(1, 74), strict=False), (21, 49), *((16, x) for x in range(32, 41))]:
        if np.isnan(before[y, x]):
            continue
        expected, extent, other = plain_disparity(maps, y, x)
        sizes.add(tuple(extent))
        taken_over += other
        # Sums are float32, from which the gray offset is subtracted.
        assert after[y, x] == pytest.approx(expected, abs=5e-3), (y, x, extent)
    assert len(sizes) > 20  # windows of many shapes
    assert taken_over >= 3


def test_pixels_beside_a_step_leave_the_wrong_surface() -> None:
    disparity = np.full((60, 120), 6, np.float32)
    disparity[15:45, 45:80] = 14
    left, right = warped_pair(60, 120, disparity)
    fields = {**UNCHECKED, "correlation_window_size": 15}
    window, adaptive = (create_matcher(name, **fields).match(left, right) for name in ("window", "adaptive_window"))
    # All around the square, but for the 8 columns to its left that the right camera does not see.
    around = np.zeros(disparity.shape, np.bool_)
    around[9:51, 45:86] = True
    wrong_window, wrong = (np.mean(np.abs(one.disparity_px - disparity)[around] > 1) for one in (window, adaptive))
    assert wrong_window > 0.05 and wrong < 0.5 * wrong_window


def test_a_brighter_camera_does_not_move_the_increments() -> None:
    left, right = (image.astype(np.float32) for image in warped_pair(40, 80, 7.25))
    before = np.full(left.shape, 7, np.float32)
    inner = np.s_[4:-4, 20:-10]
    # float32 sums of (J - I + 6)^2 and the like
    np.testing.assert_allclose(refined(left + 6, right, before)[inner], refined(left, right, before)[inner], atol=5e-3)


@pytest.mark.parametrize(("low", "shift"), [(0, 6.4), (-20, -9.3)])
def test_sub_pixel_shift(low: int, shift: float) -> None:
    left, right = warped_pair(50, 110, shift)
    fields = {**UNCHECKED, "min_disparity": low}
    inner = np.s_[6:-6, 20:-20]
    result = create_matcher("adaptive_window", **fields).match(left, right)
    check_result(result, left.shape)
    # Gray values and disparities are rounded: to 1 and to 1/16 px.
    assert np.abs(result.disparity_px[inner] - shift).max() <= 0.08


def test_increments_correct_a_wrong_start(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = warped_pair(50, 110, 7.25)
    matcher = adaptive_window.AdaptiveWindowMatcher(MatchingConfig(**UNCHECKED))
    right_start = matcher._initial.match(left, right)
    wrong = dataclasses.replace(right_start, disparity_px=right_start.disparity_px + np.float32(0.75))
    monkeypatch.setattr(matcher._initial, "match", lambda left, right: wrong)
    result = matcher.match(left, right)
    assert np.abs(result.disparity_px[6:-6, 24:-14] - 7.25).max() <= 0.08


def test_slanted_plane() -> None:
    disparity = np.tile(4 + 0.05 * np.arange(130, dtype=np.float32), (50, 1))
    left, right = warped_pair(50, 130, disparity)
    result = create_matcher("adaptive_window", **UNCHECKED).match(left, right)
    error = np.abs(result.disparity_px - disparity)[8:-8, 20:-16]
    # One disparity for a window that spans +-10 px: never off by more than the plane is within it, 0.5 px.
    assert error.max() <= 0.5 and error.mean() <= 0.2


@pytest.mark.parametrize("low", [5, -40])
def test_pixels_without_a_candidate_are_border(low: int) -> None:
    left, right = warped_pair(30, 101, low + 12)
    result = create_matcher("adaptive_window", **{**UNCHECKED, "min_disparity": low}).match(left, right)
    border = np.zeros(left.shape, np.bool_)
    border[:, : max(0, low)] = True
    border[:, 101 + min(0, low + 31) :] = True
    np.testing.assert_array_equal(result.reasons, np.where(border, Reason.BORDER, 0))
    check_result(result, left.shape)


def test_checks_are_those_of_the_window_matcher() -> None:
    disparity = np.full((50, 120), 5, np.float32)
    disparity[15:35, 60:90] = 18
    left, right = warped_pair(50, 120, disparity)
    fields = {**UNCHECKED, "disp12_max_diff": 1, "uniqueness_ratio": 10.0}
    window, adaptive = (create_matcher(name, **fields).match(left, right) for name in ("window", "adaptive_window"))
    np.testing.assert_array_equal(adaptive.reasons, window.reasons)
    assert adaptive.reason_counts()["LEFT_RIGHT"] > 50
    check_result(adaptive, left.shape)


def test_same_bytes_on_any_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = warped_pair(130, 70, 7.7)
    found = []
    for cores in (1, 2):
        monkeypatch.setattr(parallel, "core_count", lambda cores=cores: cores)
        result = create_matcher("adaptive_window", num_disparities=32, correlation_window_size=7).match(left, right)
        found.append(result.disparity_px.tobytes() + result.reasons.tobytes())
    assert found[0] == found[1]


def test_refused() -> None:
    with pytest.raises(ConfigError, match=r"disparities 2040\.\.2103 are searched"):
        create_matcher("adaptive_window", min_disparity=2040)
    with pytest.raises(ImageError, match="needs 40 x 9 px"):
        create_matcher("adaptive_window", **UNCHECKED).match(*warped_pair(20, 39, 3))
    out = np.empty((20, 50), np.float32)
    assert create_matcher("adaptive_window", **UNCHECKED).match(*warped_pair(20, 50, 3), out).disparity_px is out


@pytest.mark.real_data
@pytest.mark.parametrize("name", ["tsukuba", "venus"])
def test_real_scenes(stereo_data: Path, name: str) -> None:
    of = part(scene(name, stereo_data), slice(100, 250))

    def matched(method: str, side: int) -> MatchResult:
        result = create_matcher(method, **{**UNCHECKED, "correlation_window_size": side}).match(of.left, of.right)
        assert result.valid_fraction == 1
        return result

    found, start = matched("adaptive_window", 15), matched("window", 15)
    for limit_px in (0.5, 1.0):
        assert bad(found.disparity_px, of, limit_px) < 0.8 * bad(start.disparity_px, of, limit_px)
    for side in (3, 21):
        assert bad(found.disparity_px, of) < bad(matched("window", side).disparity_px, of)


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "side"), [("tsukuba", 9), ("venus", 11), ("Reindeer", 15)])
def test_other_starts_and_another_scene(stereo_data: Path, name: str, side: int) -> None:
    of = part(scene(name, stereo_data), slice(120, 200))
    fields = {**UNCHECKED, "num_disparities": of.num_disparities}

    def errors(method: str, side: int) -> list[float]:
        matcher = create_matcher(method, **{**fields, "correlation_window_size": side})
        result = matcher.match(of.left, of.right)
        return [bad(result.disparity_px, of, limit_px) for limit_px in (0.5, 1.0)]

    found = errors("adaptive_window", side)
    assert (np.array(found) < errors("window", side)).all()
    for other in (3, 21):
        assert found[1] < errors("window", other)[1]

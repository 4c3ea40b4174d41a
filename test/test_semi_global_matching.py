# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The semi-global matcher against the definition in 64-bit numpy, known shifts, and OpenCV's on real pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from test_census import I64, census_by_definition, costs_by_definition
from test_cost_rows import permeably_smoothed, plainly_smoothed
from test_path_costs import path_by_definition

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.datasets.middlebury_scene import MiddleburyScene
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.filters.disparity_filter import DisparityFilter
from stereo_depth_ros.matching.filters.gap_filling import fill_gaps
from stereo_depth_ros.matching.filters.plane_filling import PlaneFilling
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.sgm import semi_global_matching
from stereo_depth_ros.matching.sgm.semi_global_matching import SemiGlobalMatcher

THREE_PATHS = ((0, 1), (0, -1), (1, 0))
FOUR_PATHS = (*THREE_PATHS, (-1, 0))
EIGHT_PATHS = (*FOUR_PATHS, (1, 1), (1, -1), (-1, 1), (-1, -1))
PATHS = {3: THREE_PATHS, 4: FOUR_PATHS, 8: EIGHT_PATHS}


def matcher(**fields: Any) -> SemiGlobalMatcher:
    """A matcher without disparity filter by default; the filter is tested separately."""
    made = create_matcher("sgm", **{"disparity_filter": "none", **fields})
    assert isinstance(made, SemiGlobalMatcher)
    return made


def patches(height: int, width: int, low: int, high: int, seed: int = 0) -> tuple[U8, U8]:
    """A pair of patches with disparities of low..high, most of fine gray levels, some of few, with a little noise."""
    rng = np.random.default_rng(seed)
    right = rng.integers(0, 250, (height, width), np.uint8)
    right[:, width // 3 : width // 2] //= 100  # equal neighbors, equal costs
    steps = rng.integers(low, high + 1, (5, 4)).astype(np.float32)
    disparity = cv2.resize(steps, (width, height), interpolation=cv2.INTER_NEAREST).astype(int)
    columns = np.clip(np.arange(width) - disparity, 0, width - 1)
    left = np.take_along_axis(right, columns, axis=1)
    return left + rng.integers(0, 5, left.shape, np.uint8), right


def sums_by_definition(left: U8, right: U8, config: MatchingConfig, paths: int) -> tuple[I64, I64]:
    """Costs and sums of the paths over the whole image, int64 (H, W, K)."""
    codes = census_by_definition(left), census_by_definition(right)
    images = None if config.quality == "fast" else (left, right)
    raw = costs_by_definition(*codes, config.max_disparity, config.num_disparities, images)
    cost = plainly_smoothed(raw) if config.quality == "fast" else permeably_smoothed(raw, left)
    P1, P2 = {"fast": 20, "default": 9, "best": 12}[config.quality], 150
    P1, P2 = config.sgm_P1 or P1, config.sgm_P2 or P2
    lowered = np.maximum(6 * P2 // (6 + np.arange(256)), P1)
    return cost, sum((path_by_definition(cost, left, P1, lowered, *way) for way in PATHS[paths]), np.zeros_like(cost))


def whole_image(left: U8, right: U8, config: MatchingConfig) -> tuple[F32, U8, F32]:
    """Disparities, reasons and margins of the definition, over the whole image, without a speckle filter."""
    height, width = left.shape
    count, top = config.num_disparities, config.max_disparity
    cost, sums = sums_by_definition(left, right, config, config.sgm_paths or (4 if config.quality == "best" else 3))
    right_x = np.arange(width)[:, None] - top + np.arange(count)  # (W, K)
    seen = (right_x >= 0) & (right_x < width)
    mirrored = None
    if config.quality == "best":  # the right image on its own: mirrored, it is a left one
        mirrored = sums_by_definition(right[:, ::-1], left[:, ::-1], config, 3)[1]
    checked = config.quality != "fast" and config.uniqueness_ratio > 0
    disparity_px = np.full(left.shape, np.nan, np.float32)
    reasons = np.full(left.shape, Reason.BORDER, np.uint8)
    margins = np.zeros(left.shape, np.float32)
    for y in range(height):
        prefers = preferred_by_right_pixels(sums[y], right_x, seen)
        if mirrored is not None:
            best = [winner(mirrored[y, x], seen[x], top)[0] for x in range(width) if seen[x].any()]
            columns = [width - 1 - x for x in range(width) if seen[x].any()]
            prefers = dict(zip(columns, best, strict=True))
        for x in np.flatnonzero(seen.any(axis=1)):
            k, disparity, margin = winner(sums[y, x], seen[x], top)
            mean = np.float32(cost[y, x].sum()) * (np.float32(1) / np.float32(count))
            alike = mean - np.float32(cost[y, x, k]) < max(np.float32(0.07) * mean, np.float32(1))
            if margin < config.uniqueness_ratio / (600 if config.quality == "best" else 300) or (alike and checked):
                reasons[y, x] = Reason.UNIQUENESS
            elif abs(prefers[right_x[x, k]] - k) > (config.disp12_max_diff or 2):
                reasons[y, x] = Reason.LEFT_RIGHT
            else:
                reasons[y, x], disparity_px[y, x], margins[y, x] = 0, disparity, margin
    return disparity_px, reasons, margins


def winner(sums: I64, seen: np.ndarray, top: int) -> tuple[int, float, np.float32]:
    """Index, disparity in steps of 1/64 px and margin of one pixel; of equal sums the larger disparity wins."""
    ks = np.flatnonzero(seen)
    k = int(ks[np.argmin(sums[ks])])
    others = sums[ks[abs(ks - k) >= 2]]
    second, best = np.float32(others.min() if others.size else sums[k]), np.float32(sums[k])
    margin = (second - best) / max(second, np.float32(1))
    part = 0.0
    if k - 1 in ks and k + 1 in ks:
        before, after = int(sums[k - 1] - sums[k]), int(sums[k + 1] - sums[k])
        if max(before, after) > 0:
            u = (before - after) / (2 * max(before, after))
            part = u * (1.45 - 1.8 * u * u)
    return k, top - round((k + part) * 64) / 64, margin


def preferred_by_right_pixels(sums: I64, right_x: np.ndarray, seen: np.ndarray) -> dict[int, int]:
    """The index of the least of the sums that each right pixel of a row has a share in, of equal ones the first."""
    best: dict[int, tuple[int, int]] = {}
    for x, k in np.argwhere(seen):
        key = (int(sums[x, k]), int(k))
        at = int(right_x[x, k])
        best[at] = min(best.get(at, key), key)
    return {at: k for at, (_, k) in best.items()}


def check(result: MatchResult, shape: tuple[int, int]) -> None:
    """What holds for every result."""
    assert result.disparity_px.shape == result.reasons.shape == shape
    assert result.disparity_px.dtype == np.float32 and result.reasons.dtype == np.uint8
    np.testing.assert_array_equal(result.reasons == 0, np.isfinite(result.disparity_px))
    assert result.step_px == 1 / 64
    assert result.confidence is not None and result.confidence.dtype == np.float32
    assert result.confidence.shape == shape
    assert result.confidence.min() >= 0 and result.confidence.max() <= 1
    assert (result.confidence[result.reasons != 0] == 0).all()


def check_equal(result: MatchResult, other: MatchResult) -> None:
    for field in ("disparity_px", "reasons", "confidence"):
        np.testing.assert_array_equal(getattr(result, field), getattr(other, field), err_msg=field)


CASES: list[tuple[tuple[int, int], dict[str, Any]]] = [
    ((19, 71), {}),
    ((19, 71), {"quality": "fast"}),
    ((20, 67), {"quality": "best"}),
    ((20, 67), {"sgm_paths": 8, "sgm_P1": 7, "sgm_P2": 41}),
    ((18, 74), {"sgm_P1": 92, "sgm_P2": 93, "quality": "fast"}),  # the most that 8 bits hold
    ((17, 70), {"min_disparity": -9, "disp12_max_diff": 3, "sgm_P2": 161}),
    ((16, 83), {"min_disparity": 11, "num_disparities": 48, "uniqueness_ratio": 0.0, "sgm_paths": 8}),
    ((16, 83), {"min_disparity": -20, "num_disparities": 80, "quality": "best"}),
    ((12, 62), {"min_disparity": -45, "uniqueness_ratio": 30.0}),  # -45..-14
    ((13, 20), {"num_disparities": 64, "quality": "fast", "sgm_paths": 4}),  # images narrower than the range
    ((1, 90), {"sgm_paths": 8}),
    ((7, 1), {"uniqueness_ratio": 0.0}),
    ((2, 33), {"min_disparity": -2048, "num_disparities": 4096, "sgm_paths": 8}),
]


@pytest.mark.parametrize(("shape", "fields"), CASES)
def test_result_is_that_of_the_definition(shape: tuple[int, int], fields: dict[str, Any]) -> None:
    # Up to 20 rows the 16 rows of approach bring every strip of a quarter to the whole image.
    sgm = matcher(**{"num_disparities": 32, "speckle_size": 0, **fields})
    config = sgm.config
    left, right = patches(*shape, max(config.min_disparity, -25), min(config.max_disparity, 25))
    result = sgm.match(left, right)
    check(result, shape)
    disparity_px, reasons, margins = whole_image(left, right, config)
    np.testing.assert_array_equal(result.reasons, reasons)
    np.testing.assert_array_equal(result.disparity_px, disparity_px)
    np.testing.assert_array_equal(result.confidence, local_consistency(disparity_px, margins))
    if shape[0] > 10 and shape[1] > 60:
        assert (reasons == 0).mean() > 0.2 and (reasons == Reason.LEFT_RIGHT).any()
        assert (reasons == Reason.UNIQUENESS).any() or not config.uniqueness_ratio


@pytest.mark.parametrize("paths", [0, 4, 8])
def test_strips_with_enough_warm_up_equal_the_whole_image(paths: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(semi_global_matching, "APPROACH_ROWS", 100)
    sgm = matcher(num_disparities=32, speckle_size=0, sgm_paths=paths)
    left, right = patches(47, 60, 2, 25)
    result = sgm.match(left, right)
    disparity_px, reasons, _ = whole_image(left, right, sgm.config)
    np.testing.assert_array_equal(result.reasons, reasons)
    np.testing.assert_array_equal(result.disparity_px, disparity_px)


@pytest.mark.parametrize("paths", [0, 4])
def test_strips_differ_little_from_the_whole_image(paths: int, monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = patches(240, 160, 2, 25)
    strips = matcher(num_disparities=32, sgm_paths=paths).match(left, right)
    monkeypatch.setattr(semi_global_matching, "APPROACH_ROWS", 240)
    whole = matcher(num_disparities=32, sgm_paths=paths).match(left, right)
    # Measured: 0.1 % of the pixels have another reason, 0.2 % another disparity.
    assert 0 < (strips.disparity_px != whole.disparity_px)[whole.reasons == 0].mean() < 0.02
    assert (strips.reasons != whole.reasons).mean() < 0.005
    far = np.abs(strips.disparity_px - whole.disparity_px) > 0.5
    assert far.mean() < 0.002


@pytest.mark.parametrize(
    "fields",
    [{}, {"quality": "best"}, {"sgm_paths": 8, "disparity_filter": "median", "fill_holes": True, "quality": "fast"}],
)
def test_bytes_do_not_depend_on_the_cores(fields: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = patches(211, 130, 0, 28)
    results = []
    matchers = []
    for cores in (1, 2, 3):
        monkeypatch.setattr(parallel, "core_count", lambda cores=cores: cores)
        monkeypatch.setattr(semi_global_matching, "core_count", lambda cores=cores: cores)
        matchers.append(matcher(num_disparities=32, **fields))
        results.append(matchers[-1].match(left, right))
    monkeypatch.setattr(parallel, "core_count", lambda: 1)
    results.append(matchers[-1].match(left, right))  # buffers for three cores, one left
    assert results[0].valid_fraction > 0.5
    for result in results[1:]:
        check_equal(result, results[0])


def test_repeated_calls_and_changing_sizes_are_independent() -> None:
    sgm = matcher(num_disparities=48, sgm_paths=8)
    shapes = ((50, 90), (31, 140), (50, 90), (50, 90), (90, 50), (1, 64))
    pairs = [patches(*shape, 0, 30, seed) for seed, shape in enumerate(shapes)]
    results = [sgm.match(*pair) for pair in pairs]
    for result, pair in zip(results, pairs, strict=True):  # after all calls: what was returned stays
        check(result, pair[0].shape)
        check_equal(result, matcher(num_disparities=48, sgm_paths=8).match(*pair))


def test_read_only_and_strided_images_and_a_given_buffer() -> None:
    left, right = patches(40, 80, 0, 20)
    expected = matcher(num_disparities=32).match(left, right)
    for change in (
        lambda image: np.frombuffer(image.tobytes(), np.uint8).reshape(image.shape),
        lambda image: np.repeat(image, 2, axis=1)[:, ::2],
        np.asfortranarray,
        lambda image: image[::-1].copy()[::-1],
    ):
        out = np.full(left.shape, 7, np.float32)
        result = matcher(num_disparities=32).match(change(left), change(right), out)
        assert result.disparity_px is out
        check_equal(result, expected)


def shifted(height: int, width: int, shift: int, seed: int = 5) -> tuple[U8, U8]:
    """Noise with one disparity; what one image does not see of the other is noise as well."""
    wide = np.random.default_rng(seed).integers(0, 256, (height, width + abs(shift)), np.uint8)
    begin = max(-shift, 0)
    left, right = wide[:, begin : begin + width], wide[:, begin + shift : begin + shift + width]
    return left, right


@pytest.mark.parametrize("shift", [5, -5, 30, 0])
@pytest.mark.parametrize("quality", ["default", "best"])
def test_visible_points_are_found_where_the_range_leaves_the_image(shift: int, quality: str) -> None:
    result = matcher(min_disparity=-16, num_disparities=64, quality=quality).match(*shifted(61, 117, shift))
    check(result, (61, 117))
    columns = np.arange(117)
    both = (columns - shift >= 0) & (columns - shift < 117)
    valid = np.isfinite(result.disparity_px)
    assert valid[:, both].mean() > 0.99
    assert valid[:, ~both].sum() < 0.01 * valid.size
    # The right whole disparity wins; costs of noise on either side differ by chance, next to the border the most.
    wrong = np.flatnonzero((np.abs(result.disparity_px - shift) > 0.5).any(axis=0))
    ends = columns[both][[0, -1]]
    assert len(wrong) <= 2 and (np.abs(wrong[:, None] - ends).min(axis=1) < 3).all()


@pytest.mark.parametrize("shift", [2000, -2000])
def test_the_widest_range(shift: int) -> None:
    result = matcher(min_disparity=-2048, num_disparities=4096).match(*shifted(3, 2120, shift))
    check(result, (3, 2120))
    columns = np.arange(2120)
    both = (columns >= 2000) if shift > 0 else (columns < 120)
    valid = np.isfinite(result.disparity_px)
    assert valid[:, both].mean() > 0.97
    assert not valid[:, ~both].any()
    np.testing.assert_allclose(result.disparity_px[valid], shift, atol=0.5)


@pytest.mark.parametrize(
    ("min_disparity", "blind"), [(20, np.s_[:20]), (-45, np.s_[-14:]), (0, np.s_[:0]), (79, np.s_[:79])]
)
def test_border_is_where_no_disparity_is_in_the_right_image(min_disparity: int, blind: slice) -> None:
    left, right = patches(30, 80, 0, 20)
    result = matcher(min_disparity=min_disparity, num_disparities=32).match(left, right)
    expected = np.zeros((30, 80), bool)
    expected[:, blind] = True
    np.testing.assert_array_equal(result.reasons == Reason.BORDER, expected)


def test_a_winner_without_a_second_has_no_margin() -> None:
    left, right = shifted(40, 70, 0)
    rejected = matcher(num_disparities=32, speckle_size=0).match(left, right)
    assert (rejected.reasons[:, :2] == Reason.UNIQUENESS).all()  # disparity 0, and 0 and 1
    accepted = matcher(num_disparities=32, speckle_size=0, uniqueness_ratio=0.0).match(left, right)
    assert (accepted.disparity_px[:, 0] == 0).all()
    assert accepted.confidence is not None and (accepted.confidence[:, :2] == 0).all()
    assert (accepted.confidence[:, 2:] > 0).mean() > 0.9


def test_subpixel_disparities_are_in_order_and_no_worse_than_whole_ones() -> None:
    rng = np.random.default_rng(1)
    fine = cv2.GaussianBlur(rng.normal(0, 1, (50, 8 * 170)).astype(np.float32), (0, 0), sigmaX=12, sigmaY=1.2)
    fine = cv2.normalize(fine, None, 0, 255, cv2.NORM_MINMAX)  # 8 samples a pixel
    columns = 8 * np.arange(120) + 120
    left = np.rint(fine[:, columns]).astype(np.uint8)
    found = []
    for eighths in range(9):
        right = np.rint(fine[:, columns + 72 + eighths]).astype(np.uint8)
        result = matcher(num_disparities=32).match(left, right)
        found.append(float(np.nanmedian(result.disparity_px[:, 30:-5])) - 9)
    shifts = np.arange(9) / 8
    assert (np.diff(found) > 0).all()
    assert (np.abs(found - shifts) <= np.minimum(shifts, 1 - shifts)).all()  # P1 draws to whole pixels, not beyond


def test_speckles_are_those_of_opencv_in_steps_of_an_eighth() -> None:
    fields = {"num_disparities": 48, "min_disparity": -9, "uniqueness_ratio": 1.0}
    left, right = patches(90, 130, -8, 30)
    before = matcher(**fields, speckle_size=0).match(left, right)
    after = matcher(**fields, speckle_size=120, speckle_range=2).match(left, right)
    invalid = -16
    coarse = np.where(before.reasons == 0, np.floor(8 * (before.disparity_px + 9)), invalid).astype(np.int16)
    kept, _ = cv2.filterSpeckles(coarse.copy(), invalid, 120, 16)
    speckles = (coarse != invalid) & (kept == invalid)
    assert speckles.sum() > 100
    np.testing.assert_array_equal(after.reasons, np.where(speckles, Reason.SPECKLE, before.reasons))
    np.testing.assert_array_equal(after.disparity_px, np.where(speckles, np.float32(np.nan), before.disparity_px))


@pytest.mark.parametrize("kind", ["none", "mean", "median"])
def test_dense_mode_fills_every_pixel(kind: str) -> None:
    left, right = patches(60, 110, 0, 28)
    sparse = matcher(num_disparities=32).match(left, right)
    dense = matcher(num_disparities=32, fill_holes=True, disparity_filter=kind).match(left, right)
    check(dense, (60, 110))
    assert (dense.reasons == 0).all() and not (sparse.reasons == 0).all()
    holes = sparse.reasons != 0
    DisparityFilter(kind, 1 / 64)(sparse.disparity_px)
    PlaneFilling(1 / 64)(sparse.disparity_px, sparse.reasons, left)
    np.testing.assert_array_equal(dense.disparity_px, sparse.disparity_px)
    assert dense.confidence is not None and (dense.confidence[holes] == 0).all() and dense.confidence.mean() > 0.1


def test_short_gaps_have_a_confidence() -> None:
    left, right = patches(60, 110, 0, 28)
    sparse = matcher(num_disparities=32).match(left, right)
    result = matcher(num_disparities=32, fill_gaps_px=4).match(left, right)
    gaps = (sparse.reasons != 0) & (result.reasons == 0)
    assert gaps.sum() > 20
    fill_gaps(sparse.disparity_px, sparse.reasons, np.zeros(left.shape, np.float32), 4, 1 / 64)
    np.testing.assert_array_equal(result.disparity_px, sparse.disparity_px)
    np.testing.assert_array_equal(result.reasons, sparse.reasons)
    assert result.confidence is not None and (result.confidence[gaps] > 0).mean() > 0.9


@pytest.mark.parametrize("kind", ["mean", "median"])
def test_filter_alone_leaves_the_holes(kind: str) -> None:
    left, right = patches(60, 110, 0, 28)
    plain = matcher(num_disparities=32).match(left, right)
    result = matcher(num_disparities=32, disparity_filter=kind).match(left, right)
    assert (result.disparity_px != plain.disparity_px)[plain.reasons == 0].any()
    DisparityFilter(kind, 1 / 64)(plain.disparity_px)
    check_equal(result, plain)


@pytest.mark.parametrize("fields", [{}, {"sgm_paths": 8}, {"min_disparity": -16}, {"fill_holes": True}])
def test_images_without_texture_have_no_disparity(fields: dict[str, Any]) -> None:
    gray = np.full((33, 70), 90, np.uint8)
    result = matcher(num_disparities=32, **fields).match(gray, gray)
    check(result, (33, 70))
    assert (result.reasons == Reason.UNIQUENESS).all()


@pytest.mark.parametrize("quality", ["default", "best"])
def test_images_with_hardly_any_texture_have_hardly_any_disparity(quality: str) -> None:
    rng = np.random.default_rng(0)
    left, right = (90 + (rng.uniform(size=(120, 210)) < 0.01).astype(np.uint8) for _ in range(2))  # unrelated
    assert matcher(quality=quality).match(left, right).valid_fraction < 0.03
    for sigma, share in ((0.6, 0.1), (2, 0.05)):
        left, right = (np.rint(rng.normal(90, sigma, (120, 210))).astype(np.uint8) for _ in range(2))
        result = matcher(quality=quality).match(left, right)
        unchecked = matcher(quality=quality, uniqueness_ratio=0.0).match(left, right)
        assert result.valid_fraction < share
        assert result.valid_fraction < unchecked.valid_fraction / 2


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"sgm_P1": 50, "sgm_P2": 50}, r"sgm_P2 = 50 is not above sgm_P1 = 50: raise it"),
        ({"sgm_P2": 9}, r"sgm_P2 = 9 is not above sgm_P1 = 9: raise it"),
        ({"sgm_P1": 25, "sgm_P2": 161}, r"sgm_P1 \+ sgm_P2 = 186 is above 185.*lower one"),
        ({"sgm_paths": 6}, r"sgm_paths = 6 .*use 4 or 8"),
        ({"quality": "better"}, r"quality = .better. is not one of fast, default, best"),
    ],
)
def test_refused_parameters(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        matcher(**fields)


def test_largest_penalties_are_accepted() -> None:
    assert matcher(sgm_P1=25, sgm_P2=160).config.sgm_P2 == 160


@pytest.mark.parametrize(("low", "width"), [(50, 50), (-100, 69), (0, 0)])  # 50..81, -100..-69
def test_images_too_small_for_any_disparity(low: int, width: int) -> None:
    sgm = matcher(min_disparity=low, num_disparities=32)
    narrow, wider = np.zeros((20, width), np.uint8), np.zeros((20, width + 1), np.uint8)
    with pytest.raises(ImageError, match=rf"images of {width} x 20 px.*disparities {low}\.\.{low + 31}"):
        sgm.match(narrow, narrow)
    check(sgm.match(wider, wider), (20, width + 1))


def test_images_of_different_size() -> None:
    good = np.zeros((20, 50), np.uint8)
    with pytest.raises(ImageError, match=r"left image is \(20, 50\), right image is \(20, 49\)"):
        matcher().match(good, good[:, :49])
    with pytest.raises(ImageError, match=r"disparity buffer is float32 of shape \(20, 51\)"):
        matcher().match(good, good, np.zeros((20, 51), np.float32))


HELD_OUT = {
    "tsukuba": "middlebury2001",
    "Reindeer": "middlebury2005",
    "Baby1": "middlebury2006",
    "Cloth1": "middlebury2006",
    "Plastic": "middlebury2006",
    "terrace": "eth3d",
}


def opencv_sgbm(left: U8, right: U8, count: int) -> F32:
    sgbm = cv2.StereoSGBM.create(0, count, 3, 72, 288, 1, 0, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM)
    disparity_x16 = sgbm.compute(left, right)
    return np.where(disparity_x16 < 0, np.nan, disparity_x16 / 16).astype(np.float32)


def gray(path: Path) -> U8:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)


def percentages(disparity_px: F32, truth_px: F32) -> list[float]:
    """Density, wrong by more than 1 and 2 px of those matched, wrong by more than 2 px or missing of all with truth."""
    error = np.abs(disparity_px - truth_px)[np.isfinite(truth_px)]
    matched = error[np.isfinite(error)]
    shares = [
        matched.size / error.size,
        (matched > 1).mean(),
        (matched > 2).mean(),
        1 - (matched <= 2).sum() / error.size,
    ]
    return [100 * float(share) for share in shares]


@pytest.mark.real_data
def test_half_the_errors_of_opencv_on_scenes_not_tuned_on(stereo_data: Path) -> None:
    ours, filled, theirs = [], [], []
    for name, dataset in HELD_OUT.items():
        scene = MiddleburyScene(stereo_data / dataset / name)
        left, right = gray(scene.left_path), gray(scene.right_path)
        truth_px = scene.truth()
        assert truth_px is not None
        count = max(32, 16 * int(np.ceil((np.nanmax(truth_px) + 1) / 16)))
        sparse, dense = (
            create_matcher("sgm", num_disparities=count, fill_holes=fill).match(left, right) for fill in (False, True)
        )
        check(sparse, truth_px.shape)
        assert dense.valid_fraction == 1
        ours.append(percentages(sparse.disparity_px, truth_px))
        filled.append(percentages(dense.disparity_px, truth_px))
        theirs.append(percentages(opencv_sgbm(left, right, count), truth_px))
    (density, bad_1, bad_2, _), (*_, bad_2_all) = np.mean(ours, axis=0), np.mean(filled, axis=0)
    reference = np.mean(theirs, axis=0)
    assert density >= reference[0] + 1.5
    assert bad_1 <= 0.7 * reference[1]
    assert bad_2 <= 0.5 * reference[2]
    assert bad_2_all <= 0.36 * reference[3]

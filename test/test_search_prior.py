# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Windows of the search range of sgm, and what they are chosen by: a small pair, or the pair before."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching.costs.windows import TILE_ROWS, Windows, whole_range, windows_of
from stereo_depth_ros.matching.sgm.search_windows import (
    TILE_COLUMNS,
    changed_tiles,
    searched_share,
    windows_around,
)
from stereo_depth_ros.matching.sgm.semi_global_matching import SemiGlobalMatcher
from stereo_depth_ros.matching.sgm.strips import NARROW

HEIGHT, WIDTH, RANGE = 90, 300, 128
POLES = (140, 200, 255)  # columns
NEAR, FAR = 100, 12


def texture(seed: int, width: int = WIDTH) -> U8:
    noise = np.random.default_rng(seed).uniform(0, 255, (HEIGHT, width)).astype(np.float32)
    return np.asarray(cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.2), None, 0, 255, cv2.NORM_MINMAX), np.uint8)


def warped(right: U8, disparity: np.ndarray) -> U8:
    columns = np.clip(np.arange(right.shape[1]) - disparity, 0, right.shape[1] - 1)
    return np.take_along_axis(right, columns, axis=1)


def poles(seed: int = 1, widths: tuple[int, ...] = (5, 7, 6)) -> tuple[U8, U8, np.ndarray]:
    """Thin poles far in front of a wall; the disparities of the left image."""
    wall, front = texture(seed, WIDTH + RANGE), texture(seed + 50, WIDTH + RANGE)
    truth = np.full((HEIGHT, WIDTH), FAR)
    left, right = wall[:, :WIDTH].copy(), wall[:, FAR : FAR + WIDTH].copy()
    for column, width in zip(POLES, widths, strict=True):
        truth[:, column : column + width] = NEAR
        left[:, column : column + width] = front[:, column : column + width]
        right[:, column - NEAR : column - NEAR + width] = front[:, column : column + width]
    return left, right, truth


def made(**fields: Any) -> SemiGlobalMatcher:
    return SemiGlobalMatcher(MatchingConfig(**{"num_disparities": RANGE, "disparity_filter": "none", **fields}))


def same(found: MatchResult, expected: MatchResult) -> bool:
    return all(
        np.array_equal(a, b, equal_nan=True)
        for a, b in ((found.disparity_px, expected.disparity_px), (found.confidence, expected.confidence))
    ) and bool((found.reasons == expected.reasons).all())


class Given:
    """A search prior with these windows for both views."""

    def __init__(self, windows: Windows) -> None:
        self._windows = windows

    def windows(self, left: U8, right: U8, whole: Windows, both: bool) -> tuple[Windows, Windows]:
        return self._windows, self._windows

    def note(self, left: U8, disparity_px: F32) -> None:
        pass


def with_windows(windows: Windows, **fields: Any) -> SemiGlobalMatcher:
    matcher = made(**fields)
    matcher._search_prior = Given(windows)
    return matcher


@pytest.mark.parametrize("quality", ["default", "best"])
def test_a_window_for_all_is_a_search_of_its_disparities(quality: str) -> None:
    left, right, _ = poles()
    whole = whole_range(HEIGHT, WIDTH, RANGE)
    window = windows_of(whole.first + np.uint16(64), np.full_like(whole.size, 64))  # disparities 0 to 63
    narrow = made(num_disparities=64, quality=quality)
    narrow._search = narrow._search._replace(uniqueness=NARROW * narrow._search.uniqueness)
    expected = narrow.match(left, right)
    assert 0.5 < np.isfinite(expected.disparity_px).mean() < 0.99
    assert same(with_windows(window, quality=quality).match(left, right), expected)


def random_windows(truth: np.ndarray, seed: int) -> Windows:
    """For each tile 64, or all, of the disparities, those of its pixels among them."""
    rng = np.random.default_rng(seed)
    first, size = (np.zeros((-(-HEIGHT // TILE_ROWS), WIDTH), np.uint16) for _ in range(2))
    for tile in range(len(first)):
        for left in range(0, WIDTH, 20):
            around = RANGE - 1 - truth[tile * TILE_ROWS : (tile + 1) * TILE_ROWS, max(left - 4, 0) : left + 24]
            low, high = int(around.min()), int(around.max())
            fits = high - low < 50 and rng.uniform() < 0.8
            begin = rng.integers(max(high - 55, 0), min(low - 5, 64) + 1) // 2 * 2 if fits else 0
            first[tile, left : left + 20], size[tile, left : left + 20] = begin, 64 if fits else RANGE
    return windows_of(first, size)


@pytest.mark.parametrize("quality", ["default", "best"])
def test_windows_of_tiles_find_what_the_whole_range_finds(quality: str, monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, truth = poles()
    whole = made(quality=quality, uniqueness_ratio=0).match(left, right).disparity_px
    windows = random_windows(truth, 4)
    assert 0.4 < searched_share(windows, RANGE) < 0.9 and windows.run_count.min() > 3
    results = []
    for cores in (1, 3):
        monkeypatch.setattr(parallel, "core_count", lambda cores=cores: cores)
        results.append(with_windows(windows, quality=quality, uniqueness_ratio=0).match(left, right))
    assert same(*results)
    found = results[0].disparity_px
    rows = np.arange(HEIGHT) // TILE_ROWS
    index = RANGE - 1 - found
    valid = np.isfinite(found)
    assert (index >= windows.first[rows] - 0.5)[valid].all()
    assert (index <= windows.first[rows] + windows.size[rows] - 0.5)[valid].all()
    both = valid & np.isfinite(whole)
    assert both.mean() > 0.9 * np.isfinite(whole).mean() and np.isfinite(whole).mean() > 0.6
    assert np.mean(np.abs(found - whole)[both] <= 0.5) > 0.99


@pytest.mark.parametrize(("prior", "widths"), [("pyramid", (16, 20, 24)), ("previous", (5, 7, 6))])
def test_poles_are_found_as_in_the_whole_range(prior: str, widths: tuple[int, ...]) -> None:
    left, right, truth = poles(7, widths)
    matcher, near = made(search_prior=prior), truth == NEAR
    matcher.match(left, right)
    shares = []
    for found in (made().match(left, right), matcher.match(left, right)):
        right_px = np.abs(found.disparity_px - truth) <= 1
        shares.append(right_px[near].mean())
        assert np.mean(right_px[np.isfinite(found.disparity_px)]) > 0.97
    assert shares[0] > 0.6 and shares[1] > 0.97 * shares[0]


def test_a_changed_scene_is_searched_as_a_whole() -> None:
    first, second = poles(1), poles(2)
    matcher = made(search_prior="previous")
    expected = [made().match(left, right) for left, right, _ in (first, second)]
    assert same(matcher.match(*first[:2]), expected[0])  # nothing is known before
    assert same(matcher.match(*second[:2]), expected[1])
    again, other = (made(search_prior="previous") for _ in range(2))
    for pair in (first, first, second, first):
        assert same(again.match(*pair[:2]), other.match(*pair[:2]))
    left, right = (np.ascontiguousarray(image[:60]) for image in first[:2])
    assert same(again.match(left, right), made().match(left, right))  # another size


def test_a_range_of_one_vector_is_searched_as_a_whole() -> None:
    left, right, _ = poles()
    fields = {"num_disparities": 64, "min_disparity": 3}
    assert same(made(search_prior="pyramid", **fields).match(left, right), made(**fields).match(left, right))


@pytest.mark.parametrize("fields", [{"quality": "fast"}, {"sgm_paths": 8}, {"temporal_window": 3}])
def test_priors_that_would_have_no_effect_are_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"search_prior = pyramid is for quality default and best.*: set it to none"):
        made(search_prior="pyramid", **fields)


@pytest.mark.parametrize("scale", [1, 4])
def test_windows_have_all_that_is_known_around(scale: int) -> None:
    rng = np.random.default_rng(scale)
    margin, reach, low = 6, 16, -20
    shape = (HEIGHT // scale, WIDTH // scale)
    steps = rng.uniform(low, low + 255, (4, 9)).astype(np.float32) / scale
    known = cv2.resize(steps, shape[::-1], interpolation=cv2.INTER_LINEAR)
    known[rng.uniform(size=shape) < 0.3] = np.nan
    known[:, : shape[1] // 4] = np.nan  # a part where nothing is known
    found = windows_around(known, scale, (HEIGHT, WIDTH), low + 255, 256, margin, reach)
    assert found.first.shape == (6, WIDTH) and (found.first % 2 == 0).all() and (found.size % 64 == 0).all()
    assert (found.first[:, :32] == 0).all() and (found.size[:, :32] == 256).all()
    assert 0.3 < searched_share(found, 256) < 0.9
    assert (found.first + found.size.astype(int) <= 256).all()
    large = np.repeat(np.repeat(scale * known, scale, axis=0), scale, axis=1)
    for tile in range(6):
        for left in range(64, WIDTH - 2 * TILE_COLUMNS, TILE_COLUMNS):
            near = large[tile * TILE_ROWS : (tile + 1) * TILE_ROWS, left : left + TILE_COLUMNS]
            if not np.isfinite(near).any() or scale == 1:
                continue
            first, end = found.first[tile, left], int(found.first[tile, left]) + found.size[tile, left]
            index = low + 255 - near[np.isfinite(near)]
            assert first <= max(index.min() - margin + 1, 0) and end >= min(index.max() + margin, 256)


def test_tiles_with_other_gray_levels_have_changed() -> None:
    image = texture(3)
    other = image.copy()
    other[40:43, 70:90] += 21
    other[20:32, 130:160] = 255 - other[20:32, 130:160]
    whole = whole_range(HEIGHT, WIDTH, RANGE)
    narrow = windows_of(whole.first + np.uint16(6), np.full_like(whole.size, 64))
    found = changed_tiles(other, image, narrow, whole)
    changed = found.first == 0
    assert changed[1, 128:160].all() and changed.sum() == 32
    assert (found.size[changed] == RANGE).all() and (found.size[~changed] == 64).all()
    assert changed_tiles(image, image, narrow, whole) is narrow

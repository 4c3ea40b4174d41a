# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Filters of disparities against their definitions, neighborhood by neighborhood."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.matching.filters.disparity_filter import DisparityFilter

NAN = np.nan


def median_slowly(disparity_px: F32) -> F32:
    result = disparity_px.copy()
    for y, x in np.argwhere(np.isfinite(disparity_px)):
        near = disparity_px[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        valid = np.sort(near[np.isfinite(near)])
        result[y, x] = valid[(len(valid) - 1) // 2]
    return result


def test_neighborhoods_computed_by_hand() -> None:
    disparity_px = np.array([[9, 1, NAN, 8], [2, 7, NAN, NAN], [3, 4, 5, NAN]], np.float32)
    DisparityFilter("median", 1 / 64)(disparity_px)
    # Bottom row: the lower of 2 3 4 7, 4 of 2 3 4 5 7, 5 of 4 5 7; the 8 is alone.
    expected = [[2, 2, NAN, 8], [3, 4, NAN, NAN], [3, 4, 5, NAN]]
    np.testing.assert_array_equal(disparity_px, np.array(expected, np.float32))


@pytest.mark.parametrize("cores", [1, 2, 3])
def test_median_is_that_of_sorting(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "core_count", lambda: cores)
    median_filter = DisparityFilter("median", 1 / 64)
    rng = np.random.default_rng(cores)
    for shape in ((197, 31), (1, 40), (23, 1), (197, 31)):  # sizes change: the buffer follows
        before = np.rint(rng.uniform(-30, 30, shape)).astype(np.float32)  # whole numbers: many are equal
        before[rng.uniform(size=shape) < 0.4] = NAN
        after = before.copy()
        median_filter(after)
        np.testing.assert_array_equal(after, median_slowly(before))
        np.testing.assert_array_equal(np.isnan(after), np.isnan(before))
        assert (after != before)[np.isfinite(before)].any()


def mean_slowly(disparity_px: F32) -> F32:
    result = disparity_px.copy()
    for y, x in np.argwhere(np.isfinite(disparity_px)):
        near = disparity_px[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3].astype(np.float64)
        like = near[np.abs(near - disparity_px[y, x]) <= 1]
        result[y, x] = np.rint(64 * like.mean()) / 64
    return result


@pytest.mark.parametrize("cores", [1, 2, 3])
def test_mean_is_that_of_similar_neighbors(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "core_count", lambda: cores)
    mean_filter = DisparityFilter("mean", 1 / 64)
    rng = np.random.default_rng(cores)
    for shape in ((197, 31), (1, 40), (23, 1), (140, 62)):
        before = (rng.integers(20, 23, shape) + rng.integers(0, 64, shape) / 64).astype(np.float32)
        before[rng.uniform(size=shape) < 0.3] = NAN
        after = before.copy()
        mean_filter(after)
        expected = mean_slowly(before)
        np.testing.assert_array_equal(np.isnan(after), np.isnan(expected))
        # a mean half way between two steps may be rounded to either
        assert np.nanmax(np.abs(after - expected)) <= 1 / 64
        assert np.mean((after == expected) | np.isnan(expected)) > 0.98


def test_mean_keeps_slopes_and_steps() -> None:
    y, x = np.mgrid[:30, :40]
    disparity_px = (10 + x / 8 + y / 16).astype(np.float32)
    disparity_px[:, 20:] += 1.5
    before = disparity_px.copy()
    DisparityFilter("mean", 1 / 64)(disparity_px)
    inside = np.ones(before.shape, bool)
    inside[:2] = inside[-2:] = inside[:, :2] = inside[:, -2:] = inside[:, 18:22] = False
    np.testing.assert_array_equal(disparity_px[inside], before[inside])
    assert np.abs(disparity_px - before).max() <= 3 / 16  # windows that end at the edge lean to one side


def test_none_changes_nothing() -> None:
    disparity_px = np.array([[3.25, NAN, 9.5]], np.float32)
    DisparityFilter("none", 1 / 64)(disparity_px)
    np.testing.assert_array_equal(disparity_px, np.array([[3.25, NAN, 9.5]], np.float32))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Median filter against sorting every neighbourhood."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros import parallel
from stereo_depth_ros.matching.median import MedianFilter
from stereo_depth_ros.types import F32

NAN = np.nan


def median_slowly(disparity_px: F32) -> F32:
    result = disparity_px.copy()
    for y, x in np.argwhere(np.isfinite(disparity_px)):
        near = disparity_px[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        valid = np.sort(near[np.isfinite(near)])
        result[y, x] = valid[(len(valid) - 1) // 2]
    return result


def test_neighbourhoods_computed_by_hand() -> None:
    disparity_px = np.array([[9, 1, NAN, 8], [2, 7, NAN, NAN], [3, 4, 5, NAN]], np.float32)
    MedianFilter()(disparity_px)
    # Bottom row: the lower of 2 3 4 7, 4 of 2 3 4 5 7, 5 of 4 5 7; the 8 is alone.
    expected = [[2, 2, NAN, 8], [3, 4, NAN, NAN], [3, 4, 5, NAN]]
    np.testing.assert_array_equal(disparity_px, np.array(expected, np.float32))


@pytest.mark.parametrize("cores", [1, 2, 3])
def test_median_is_that_of_sorting(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "core_count", lambda: cores)
    median_filter = MedianFilter()
    rng = np.random.default_rng(cores)
    for shape in ((197, 31), (1, 40), (23, 1), (197, 31)):  # sizes change: the buffer follows
        before = np.rint(rng.uniform(-30, 30, shape)).astype(np.float32)  # whole numbers: many are equal
        before[rng.uniform(size=shape) < 0.4] = NAN
        after = before.copy()
        median_filter(after)
        np.testing.assert_array_equal(after, median_slowly(before))
        np.testing.assert_array_equal(np.isnan(after), np.isnan(before))
        assert (after != before)[np.isfinite(before)].any()

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Filling of short gaps, of rows computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core import bands
from stereo_depth_ros.core.types import Reason
from stereo_depth_ros.matching.filters.gap_filling import fill_gaps

NAN = np.nan


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ([5, NAN, NAN, NAN, 6], [5, 5.25, 5.5, 5.75, 6]),  # the longest, and the largest step
        ([7.5, NAN, 7, 6, NAN, NAN, 6], [7.5, 7.25, 7, 6, 6, 6, 6]),
        ([5, NAN, 6.125], [5, NAN, 6.125]),  # another surface
        ([5, NAN, 3.875], [5, NAN, 3.875]),
        ([5, NAN, NAN, NAN, NAN, 5], [5, NAN, NAN, NAN, NAN, 5]),  # longer than 3 px
        ([NAN, 4, NAN, NAN], [NAN, 4, NAN, NAN]),  # one end
        ([NAN, NAN, NAN], [NAN, NAN, NAN]),
        ([-2, NAN, NAN, -1], [-2, -1.625, -1.375, -1]),  # thirds, rounded to eighths
    ],
)
def test_gaps_of_a_row(row: list[float], expected: list[float]) -> None:
    disparity_px = np.array([row], np.float32)
    hole = np.isnan(disparity_px)
    reasons = np.where(hole, int(Reason.UNIQUENESS), 0).astype(np.uint8)
    margin = np.where(hole, 0, np.linspace(0.75, 0.25, len(row))).astype(np.float32)
    before = margin.copy()
    fill_gaps(disparity_px, reasons, margin, 3, 1 / 8)
    np.testing.assert_array_equal(disparity_px, [expected])
    np.testing.assert_array_equal(reasons, np.where(np.isnan([expected]), int(Reason.UNIQUENESS), 0))
    for x in np.flatnonzero(hole[0] & (reasons[0] == 0)):  # margins fall along the row
        assert margin[0, x] == before[0, x:][~hole[0, x:]][0]
    np.testing.assert_array_equal(margin[0, reasons[0] != 0], 0)
    np.testing.assert_array_equal(margin[~hole], before[~hole])


def test_a_lesser_margin_on_the_left_counts_as_well() -> None:
    disparity_px, margin = np.array([[3, NAN, 3]], np.float32), np.array([[0.25, 0, 0.5]], np.float32)
    fill_gaps(disparity_px, np.zeros((1, 3), np.uint8), margin, 1, 1 / 64)
    np.testing.assert_array_equal(margin, np.array([[0.25, 0.25, 0.5]], np.float32))


@pytest.mark.parametrize("cores", [1, 3])
def test_rows_are_independent_and_none_is_left_out(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bands, "core_count", lambda: cores)
    disparity_px = np.arange(200, dtype=np.float32)[:, None] + np.array([0, NAN, 0.5, NAN, NAN], np.float32)
    margin = np.ones(disparity_px.shape, np.float32)
    before = disparity_px.copy()
    fill_gaps(disparity_px, np.zeros(disparity_px.shape, np.uint8), margin, 0, 1 / 64)
    np.testing.assert_array_equal(disparity_px, before)  # 0 fills none
    fill_gaps(disparity_px, np.zeros(disparity_px.shape, np.uint8), margin, 1, 1 / 64)
    before[:, 1] = np.arange(200) + 0.25
    np.testing.assert_array_equal(disparity_px, before)

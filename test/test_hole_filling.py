# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hole filling of rows computed by hand, and against a slow search for the neighbors."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.types import F32, U8, Reason
from stereo_depth_ros.matching.filters.hole_filling import fill_holes

NAN = np.nan


def filled(rows: list[list[float]]) -> tuple[F32, U8]:
    disparity_px = np.array(rows, np.float32)
    reasons = np.where(np.isnan(disparity_px), int(Reason.LEFT_RIGHT), 0).astype(np.uint8)
    fill_holes(disparity_px, reasons)
    return disparity_px, reasons


def filled_slowly(disparity_px: F32) -> F32:
    """Every hole by the definition: the lower of the nearest to left and right, in its row or the nearest with any."""
    result = disparity_px.copy()
    known = [y for y in range(len(result)) if np.isfinite(disparity_px[y]).any()]
    for y, x in np.argwhere(np.isnan(disparity_px)):
        row = disparity_px[min(known, key=lambda other: abs(other - y))] if y not in known else disparity_px[y]
        left, right = row[: x + 1][np.isfinite(row[: x + 1])], row[x:][np.isfinite(row[x:])]
        result[y, x] = min([*left[-1:], *right[:1]])
    return result


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ([5, NAN, NAN, 3, 4], [5, 3, 3, 3, 4]),  # the lower of both sides, wherever it is
        ([3, NAN, 5, NAN, 2], [3, 3, 5, 2, 2]),
        ([NAN, NAN, 7, 1], [7, 7, 7, 1]),  # only the nearest count, not the 1 behind
        ([2, 9, NAN, NAN], [2, 9, 9, 9]),
        ([NAN, -4.25, NAN, -3, NAN], [-4.25, -4.25, -4.25, -3, -3]),
        ([NAN, 0, NAN], [0, 0, 0]),
        ([6], [6]),
    ],
)
def test_holes_of_a_row(row: list[float], expected: list[float]) -> None:
    disparity_px, reasons = filled([row])
    np.testing.assert_array_equal(disparity_px, [expected])
    assert (reasons == 0).all()


def test_empty_rows_are_copied_from_the_nearest_row() -> None:
    empty = [NAN] * 3
    disparity_px, reasons = filled([empty, [NAN, 4, 2], empty, empty, empty, [8, NAN, 6], empty])
    first, second = [4, 4, 2], [8, 6, 6]  # holes of a row are filled before others take it
    np.testing.assert_array_equal(disparity_px, [first, first, first, first, second, second, second])
    assert (reasons == 0).all()


def test_row_halfway_is_copied_from_above() -> None:
    disparity_px, _ = filled([[1, 2], [NAN, NAN], [3, 4]])
    np.testing.assert_array_equal(disparity_px[1], [1, 2])


def test_empty_map_stays_empty() -> None:
    disparity_px, reasons = filled([[NAN] * 5] * 3)
    assert np.isnan(disparity_px).all()
    assert (reasons == Reason.LEFT_RIGHT).all()


@pytest.mark.parametrize("cores", [1, 2, 3])
def test_every_pixel_is_filled_by_the_definition(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "core_count", lambda: cores)
    rng = np.random.default_rng(7)
    before = rng.uniform(-20, 60, (201, 37)).astype(np.float32)
    before[rng.uniform(size=before.shape) < 0.8] = NAN
    before[60:75] = NAN  # over the seam of two and of three bands
    before[130:140] = NAN
    after, reasons = filled(before.tolist())
    np.testing.assert_array_equal(after, filled_slowly(before))
    assert np.isfinite(after).all() and (reasons == 0).all()
    np.testing.assert_array_equal(after[np.isfinite(before)], before[np.isfinite(before)])

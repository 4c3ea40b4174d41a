# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matched line segments are checked beside the line: on which of its sides is a surface with its disparity."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.matching.features.row_search import Pixels, search_rows

__all__ = ["LineSides", "check_lines"]

Mask: TypeAlias = npt.NDArray[np.bool_]

BESIDE_PX = 4.0  # from the line to the pixels whose windows are compared
MOST_ROWS = 12  # of a segment, evenly spread
LEAST_CORRELATION, LARGEST_DIFFERENCE_PX = 0.8, 0.7
LEAST_SHARE = 0.8  # of the rows


class LineSides(NamedTuple):
    """For S segments, bool (S,): whether the surface on the side of smaller x, of larger x, has the disparity."""

    smaller: Mask
    larger: Mask


def check_lines(
    left: U8, right: U8, segment: npt.NDArray[np.intp], left_xy: F64, disparity_px: F64, search_px: tuple[int, int]
) -> LineSides:
    """Whether the images beside matched segments move with them.

    An edge in front of another surface moves with one side only, that of the near surface; an edge on a surface moves
    with both; a wrong match with none. On each side, in up to 12 rows of the segment, the window around the pixel 4 px
    beside the line (:func:`search_rows`) must correlate by 0.8 at a disparity within 0.7 px of that of the line, and
    better than anywhere else in the search range; in four rows of five, whatever hides the others.

    Args:
        left, right: uint8 (H, W), gray.
        segment: (N,), ascending, the segment 0..S - 1 of each point; each has points. Without any, S is 0.
        left_xy: float64 (N, 2), a point in each row of the segment, px.
        disparity_px: float64 (N,).
        search_px: first and last disparity searched.
    """
    if not len(segment):
        return LineSides(np.zeros(0, np.bool_), np.zeros(0, np.bool_))
    count = np.bincount(segment)
    rank = np.arange(len(segment)) - (np.cumsum(count) - count)[segment]
    rows = np.minimum(count, MOST_ROWS)[segment]
    chosen = np.flatnonzero(rank * rows // count[segment] != (rank - 1) * rows // count[segment])
    height, width = left.shape
    y = np.rint(left_xy[chosen, 1]).astype(np.int64).clip(0, height - 1)
    expected_px = disparity_px[chosen]
    slant = _growth(segment, left_xy[:, 1], disparity_px)[segment[chosen]]
    sides = []
    for beside_px in (-BESIDE_PX, BESIDE_PX):
        x = np.rint(left_xy[chosen, 0] + beside_px).astype(np.int64)
        inside = (x >= 0) & (x < width)
        found = search_rows(left, right, Pixels(x.clip(0, width - 1), y, y, expected_px, slant), search_px, sign=1)
        agree = inside & (np.abs(found.disparity_px - expected_px) <= LARGEST_DIFFERENCE_PX)
        agree &= (found.correlation >= LEAST_CORRELATION) & (found.expected >= found.elsewhere)
        share = np.bincount(segment[chosen], agree) / np.bincount(segment[chosen])
        sides.append(share >= LEAST_SHARE)
    return LineSides(*sides)


def _growth(segment: npt.NDArray[np.intp], y: F64, disparity_px: F64) -> F64:
    """By how much the disparity grows from row to row, of each segment, whose disparities lie on a line."""
    last = np.cumsum(np.bincount(segment)) - 1
    first = np.append(0, last[:-1] + 1)
    rows = y[last] - y[first]
    growth: F64 = np.divide(disparity_px[last] - disparity_px[first], rows, out=np.zeros(len(rows)), where=rows > 0)
    return growth

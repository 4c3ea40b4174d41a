# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matched corners are refined along their rows, and checked: by correlation, from right to left, by their neighbors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64, U8, Reason
from stereo_depth_ros.matching.features.row_search import Pixels, search_rows

__all__ = ["CheckedCorners", "agree_with_neighbors", "check_corners"]

LEAST_CORRELATION = 0.85
NOISE = 0.03  # differences of correlations below it mean nothing
LARGEST_MOVE_PX = 1.0  # from the disparity of the detectors
RETURN_PX = 0.5  # from right to left; slanted surfaces differ between the two pixels
NEIGHBORS, LEAST_AGREEING = 16, 0.75
SAME_PX, SLANT = 1.0, 0.08  # neighbors agree within a pixel and 0.08 px for each pixel of their distance


@dataclass(frozen=True)
class CheckedCorners:
    """N corners after the checks.

    Attributes:
        disparity_px: float64 (N,), refined; of no meaning where it is rejected.
        reasons: uint8 (N,), :class:`Reason` of those rejected, 0 for the others.
    """

    disparity_px: F64
    reasons: U8


def check_corners(
    left: U8, right: U8, left_xy: F64, right_xy: F64, search_px: tuple[int, int], unique: bool
) -> CheckedCorners:
    """Refine and check N pairs of corners, see :func:`search_rows` for windows and iteration.

    The disparity is that of the pixel that contains the left corner: near depth edges this is the surface whose gray
    values the pixel has. Rejected are corners whose window correlates with its match by less than 0.85 or whose
    refinement moves by more than 1 px (NO_MATCH), whose window finds as good a match elsewhere in the search range
    (UNIQUENESS), and those where the window of the right pixel returns another disparity (LEFT_RIGHT).

    Args:
        left, right: uint8 (H, W), gray.
        left_xy, right_xy: float64 (N, 2), px.
        search_px: first and last disparity searched.
        unique: whether there must not be as good a match elsewhere.
    """
    height, width = left.shape
    x, y = _pixels(left_xy[:, 0], width), _pixels(left_xy[:, 1], height)
    right_y = _pixels(y + np.rint(right_xy[:, 1] - left_xy[:, 1]), height)
    expected_px = left_xy[:, 0] - right_xy[:, 0]
    upright = np.zeros(len(x))
    ours = search_rows(left, right, Pixels(x, y, right_y, expected_px, upright), search_px, sign=1)
    disparity_px = np.where(np.isnan(ours.disparity_px), expected_px, ours.disparity_px)
    right_x = _pixels(x - disparity_px, width)
    theirs = search_rows(right, left, Pixels(right_x, right_y, y, disparity_px, upright), search_px, sign=-1)
    moved = np.abs(disparity_px - expected_px) > LARGEST_MOVE_PX
    unmatched = np.isnan(ours.disparity_px) | (ours.correlation < LEAST_CORRELATION) | moved
    repeated = unique & (ours.elsewhere > ours.expected - NOISE)
    back = np.isnan(theirs.disparity_px) | (np.abs(theirs.disparity_px - disparity_px) > RETURN_PX)
    back |= theirs.elsewhere > theirs.expected
    why = np.select((unmatched, repeated, back), (Reason.NO_MATCH, Reason.UNIQUENESS, Reason.LEFT_RIGHT), Reason.VALID)
    return CheckedCorners(disparity_px, why.astype(np.uint8))


def agree_with_neighbors(xy: F64, disparity_px: F64) -> npt.NDArray[np.bool_]:
    """Whether three quarters of the 16 nearest others have the same disparity up to the slant of a surface, bool (N,).

    At a depth edge without texture behind it nothing but the neighbors says that a corner has the disparity of the
    surface in front, though its pixel may belong to the one behind. So corners beside such edges are rejected together
    with wrong ones. Where there are fewer than three others, nothing is rejected.

    Args:
        xy: float64 (N, 2), positions, px.
        disparity_px: float64 (N,).
    """
    count = min(NEIGHBORS, len(xy) - 1)
    if count < 3:
        return np.ones(len(xy), np.bool_)
    agree = np.empty(len(xy), np.bool_)
    for begin in range(0, len(xy), 512):  # bounds the memory
        block = slice(begin, begin + 512)
        distance_px = np.hypot(*np.moveaxis(xy[block, None] - xy, 2, 0))
        distance_px[np.arange(len(distance_px)), np.arange(len(distance_px)) + begin] = np.inf
        near = np.argpartition(distance_px, count - 1, axis=1)[:, :count]
        difference = np.abs(disparity_px[near] - disparity_px[block, None])
        same = difference <= SAME_PX + SLANT * np.take_along_axis(distance_px, near, axis=1)
        agree[block] = same.mean(axis=1) >= LEAST_AGREEING
    return agree


def _pixels(values: npt.NDArray[Any], size: int) -> npt.NDArray[np.int64]:
    """Whole numbers inside 0..size - 1."""
    inside: npt.NDArray[np.int64] = np.rint(values).astype(np.int64).clip(0, size - 1)
    return inside

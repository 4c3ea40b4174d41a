# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Features of a rectified pair that are matched across rows, and how far apart their rows are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.matching.protocol import check_images

__all__ = ["RowMatches", "match_rows"]

CELLS = (6, 10)  # rows and columns of the image, each with its own strongest corners
CORNERS_PER_CELL = 24  # of the left image; twice as many of the right, where the same place may be in another cell
FAST_THRESHOLD = 7
LARGEST_ROW_ERROR = 0.05  # of the height; and at least 8 px
LARGEST_DISPARITY = 0.25  # of the width, either way
MAX_BITS = 64  # of 256, that the descriptors of one place may differ in
RATIO = 0.8  # of the distance of the second best
WINDOW_PX = (15, 15)
MAX_REFINEMENT_PX, MAX_RETURN_PX = 3.0, 0.3
PLANE_ROUNDS, MIN_FOR_PLANE = 3, 10
FAR_DEVIATIONS, FAR_PX = 4.0, 1.0  # from the plane; more is wrong, less than so many px never
_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 0.003)


@dataclass(frozen=True, eq=False)
class RowMatches:
    """N points of the left rectified image and the same points in the right one.

    Attributes:
        left_px, right_px: float64 (N, 2), columns x and y, px; pixel centers are whole numbers.
    """

    left_px: F64
    right_px: F64

    def __len__(self) -> int:
        return len(self.left_px)

    @property
    def errors_px(self) -> F64:
        """float64 (N,), row errors y_left - y_right."""
        errors: F64 = self.left_px[:, 1] - self.right_px[:, 1]
        return errors

    @property
    def median_px(self) -> float:
        """Half of the row errors are smaller, either way; NaN without matches."""
        return float(np.median(np.abs(self.errors_px))) if len(self) else math.nan

    @property
    def rms_px(self) -> float:
        """Root of the mean squared row error; NaN without matches."""
        return float(np.sqrt(np.mean(self.errors_px**2))) if len(self) else math.nan


def match_rows(left: U8, right: U8) -> RowMatches:
    """Corners (FAST, Rosten and Drummond 2006) from all over a pair, matched in both directions by ORB (Rublee 2011).

    Rows may differ by 5 % of the height. Right points are refined to a small part of a pixel (Lucas and Kanade 1981),
    and kept where the way back ends at the left point.

    Args:
        left, right: uint8 (H, W), gray, rectified.

    Returns:
        The matches, in a fixed order; few or none where the images show nothing in common. Those are left out whose
        row error is far from a plane over the image that most of them are near to.

    Raises:
        ImageError: not two gray uint8 images of one size.
    """
    check_images(left, right)
    left_xy, left_descriptors = _corners(left, CORNERS_PER_CELL)
    right_xy, right_descriptors = _corners(right, 2 * CORNERS_PER_CELL)
    if min(len(left_xy), len(right_xy)) < 2:
        return RowMatches(np.empty((0, 2)), np.empty((0, 2)))
    i, j = _mutual_best(left_descriptors, right_descriptors, _allowed(left_xy, right_xy, left.shape))
    return _without_wrong(_refined(left, right, left_xy[i], right_xy[j]))


def _corners(image: U8, per_cell: int) -> tuple[F64, U8]:
    """Positions, float64 (N, 2) px, and ORB descriptors, uint8 (N, 32), of the strongest corners of each cell."""
    corners = cv2.FastFeatureDetector.create(FAST_THRESHOLD).detect(image)
    corners, words = cv2.ORB.create().compute(image, _strongest(corners, image.shape, per_cell))
    if not corners:
        return np.empty((0, 2)), np.empty((0, 32), np.uint8)
    return np.array(cv2.KeyPoint.convert(corners), np.float64), np.asarray(words, np.uint8)


def _strongest(corners: Sequence[Any], shape: tuple[int, ...], per_cell: int) -> list[Any]:
    if not corners:
        return []
    xy, response = np.array(cv2.KeyPoint.convert(corners)), np.array([corner.response for corner in corners])
    row, column = (xy[:, ::-1] * CELLS // shape[:2]).astype(np.intp).T
    cell = row * CELLS[1] + column
    order = np.lexsort((-response, cell))
    place = np.arange(len(order)) - np.searchsorted(cell[order], cell[order])
    return [corners[k] for k in order[place < per_cell]]


def _allowed(left_xy: F64, right_xy: F64, shape: tuple[int, ...]) -> U8:
    """uint8 (N, M), 1 where a left and a right corner are near enough to be one place."""
    far_x, far_y = np.abs(left_xy[:, None] - right_xy).transpose(2, 0, 1)
    near = (far_y <= max(8, LARGEST_ROW_ERROR * shape[0])) & (far_x <= LARGEST_DISPARITY * shape[1])
    return np.asarray(near, np.uint8)


def _mutual_best(left: U8, right: U8, allowed: U8) -> npt.NDArray[np.intp]:
    """(2, K) indices of left and right words that are each other's nearest, the left one's by the ratio."""
    matcher = cv2.BFMatcher.create(cv2.NORM_HAMMING)
    from_right = matcher.knnMatch(right, left, 1, np.ascontiguousarray(allowed.T))
    back = {best[0].queryIdx: best[0].trainIdx for best in from_right if best}
    chosen = []
    for best, *others in filter(None, matcher.knnMatch(left, right, 2, allowed)):
        clear = best.distance <= MAX_BITS and all(best.distance < RATIO * other.distance for other in others)
        if clear and back.get(best.trainIdx) == best.queryIdx:
            chosen.append((best.queryIdx, best.trainIdx))
    return np.array(chosen, np.intp).reshape(-1, 2).T


def _refined(left: U8, right: U8, left_xy: F64, right_xy: F64) -> RowMatches:
    if not len(left_xy):
        return RowMatches(left_xy, right_xy)
    start, guess = left_xy.astype(np.float32), right_xy.astype(np.float32)
    moved, found = _tracked(left, right, start, guess)
    returned, found_back = _tracked(right, left, moved, start)
    good = found & found_back
    good &= np.abs(moved - guess).max(axis=1) <= MAX_REFINEMENT_PX
    good &= np.abs(returned - start).max(axis=1) <= MAX_RETURN_PX
    return RowMatches(left_xy[good], moved[good].astype(np.float64))


def _tracked(
    source: U8, target: U8, points: npt.NDArray[np.float32], guess: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points,
        guess.copy(),
        winSize=WINDOW_PX,
        maxLevel=0,
        criteria=_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return moved, found.ravel() != 0


def _without_wrong(matches: RowMatches) -> RowMatches:
    """Those whose row error is near to a plane over the image, which is fitted to them."""
    if len(matches) < MIN_FOR_PLANE:
        return matches
    errors, basis = matches.errors_px, np.column_stack((matches.left_px, np.ones(len(matches))))
    rest = errors - np.median(errors)
    for _ in range(PLANE_ROUNDS):
        near = _near(rest)
        rest = errors - basis @ np.linalg.lstsq(basis[near], errors[near], rcond=None)[0]
    near = _near(rest)
    return RowMatches(matches.left_px[near], matches.right_px[near])


def _near(rest: F64) -> npt.NDArray[np.bool_]:
    near: npt.NDArray[np.bool_] = np.abs(rest) <= max(FAR_PX, FAR_DEVIATIONS * 1.4826 * float(np.median(np.abs(rest))))
    return near

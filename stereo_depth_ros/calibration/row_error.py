# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Row errors of a rectified pair, measured by features that are matched across rows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.geometry.robust import robust_sigma
from stereo_depth_ros.matching.features.corners import detect_fast, mutual_best, squared_distances
from stereo_depth_ros.matching.features.lucas_kanade import refine_right_points
from stereo_depth_ros.matching.protocol import check_images

__all__ = ["RowMatches", "match_rows"]

CELLS = (6, 10)  # rows and columns of the image, each with its own strongest corners
CORNERS_PER_CELL = 24  # of the left image; twice as many of the right, where the same place may be in another cell
FAST_THRESHOLD = 7
LARGEST_ROW_ERROR = 0.05  # largest row error as a fraction of the image height, at least 8 px
LARGEST_DISPARITY = 0.25  # largest absolute disparity as a fraction of the image width
MAX_BITS = 64  # largest Hamming distance of a match, of 256 bits
RATIO = 0.8  # of Lowe's test: largest ratio of the distances of the best and the second best match
WINDOW_PX, EPSILON_PX = 15, 0.003
MAX_REFINEMENT_PX, MAX_RETURN_PX = 3.0, 0.3
PLANE_ROUNDS, MIN_FOR_PLANE = 3, 10
OUTLIER_SIGMAS, OUTLIER_PX = 4.0, 1.0  # residuals from the plane above both are outliers


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
        """Median of the absolute row errors; NaN without matches."""
        return float(np.median(np.abs(self.errors_px))) if len(self) else math.nan

    @property
    def rms_px(self) -> float:
        """Root of the mean squared row error; NaN without matches."""
        return float(np.sqrt(np.mean(self.errors_px**2))) if len(self) else math.nan


def match_rows(
    left: U8, right: U8, corners_per_cell: int = CORNERS_PER_CELL, reach_px: float | None = None
) -> RowMatches:
    """Match FAST corners (Rosten and Drummond 2006) by mutually best ORB descriptors (Rublee et al. 2011).

    Right points are refined to sub-pixel accuracy (Lucas and Kanade 1981), and
    rejected where tracking back does not end at the left point.

    Args:
        left, right: uint8 (H, W), gray, rectified.
        corners_per_cell: largest number of corners of each of 60 cells of the left image; fewer are faster.
        reach_px: largest row error that is found, px; None is 5 % of the height, at least 8 px.

    Returns:
        The matches, in a fixed order; few or none where the images show different scenes. Outliers from a plane fitted
        to the row errors over the image are removed.

    Raises:
        ImageError: not two gray uint8 images of one size.
    """
    check_images(left, right)
    left_xy, left_bits = detect_fast(left, FAST_THRESHOLD, CELLS, corners_per_cell)
    right_xy, right_bits = detect_fast(right, FAST_THRESHOLD, CELLS, 2 * corners_per_cell)
    if min(len(left_xy), len(right_xy)) < 2:
        return RowMatches(np.empty((0, 2)), np.empty((0, 2)))
    distances = squared_distances(left_bits, right_bits)
    reach_px = max(8, LARGEST_ROW_ERROR * len(left)) if reach_px is None else reach_px
    distances[~_candidates(left_xy, right_xy, LARGEST_DISPARITY * left.shape[1], reach_px)] = np.inf
    i, j = mutual_best(distances, RATIO)
    close = distances[i, j] <= MAX_BITS
    return _without_outliers(_refined(left, right, left_xy[i[close]], right_xy[j[close]]))


def _candidates(left_xy: F64, right_xy: F64, x_px: float, y_px: float) -> npt.NDArray[np.bool_]:
    """bool (N, M), the pairs of corners within the largest disparity and row error."""
    (left_x, left_y), (right_x, right_y) = left_xy.astype(np.float32).T, right_xy.astype(np.float32).T
    near: npt.NDArray[np.bool_] = np.abs(left_x[:, None] - right_x) <= x_px
    near &= np.abs(left_y[:, None] - right_y) <= y_px
    return near


def _refined(left: U8, right: U8, left_xy: F64, right_xy: F64) -> RowMatches:
    moved, refined = refine_right_points(
        left,
        right,
        left_xy,
        right_xy,
        window_px=WINDOW_PX,
        max_move_px=MAX_REFINEMENT_PX,
        epsilon_px=EPSILON_PX,
        max_return_px=MAX_RETURN_PX,
    )
    return RowMatches(left_xy[refined], moved[refined])


def _without_outliers(matches: RowMatches) -> RowMatches:
    """The matches whose row error is near a plane over the image, fitted to them."""
    if len(matches) < MIN_FOR_PLANE:
        return matches
    errors, basis = matches.errors_px, np.column_stack((matches.left_px, np.ones(len(matches))))
    residuals = errors - np.median(errors)
    for _ in range(PLANE_ROUNDS):
        inliers = _inliers(residuals)
        residuals = errors - basis @ np.linalg.lstsq(basis[inliers], errors[inliers], rcond=None)[0]
    inliers = _inliers(residuals)
    return RowMatches(matches.left_px[inliers], matches.right_px[inliers])


def _inliers(residuals: F64) -> npt.NDArray[np.bool_]:
    sigma_px = robust_sigma(residuals)
    near: npt.NDArray[np.bool_] = np.abs(residuals) <= max(OUTLIER_PX, OUTLIER_SIGMAS * sigma_px)
    return near

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Line segments: detection, description and similarity."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64, U8

__all__ = ["LineSegments", "common_rows", "detect_segments", "line_similarity"]

MIN_LENGTH_PX = 10.0
# On flatter segments, an error of one row causes a disparity error of three columns or more.
MIN_SLOPE_DEG = 20.0
# The detector works at a scale of 0.8 and ignores pixel centers when it scales coordinates back.
CENTER_SHIFT_PX = 0.5 / 0.8 - 0.5
CONTRAST_OFFSET_PX = 2.0  # from the segment to the samples on its two sides
CONTRAST_SAMPLES = 16

# Standard deviations of the differences between the two images of one segment; the weights are their inverse squares.
LENGTH_SIGMA_PX = 30.0  # end points are unreliable
ORIENTATION_SIGMA_RAD = np.radians(5.0)
MIDPOINT_SIGMA_PX = 15.0  # half the error of an end point
CONTRAST_SIGMA = 15.0


@dataclass(frozen=True, eq=False)
class LineSegments:
    """N segments of one image and their descriptors.

    Attributes:
        ends: float64 (N, 2, 2), the upper end, then the lower one, each (x, y) in px; pixel centers are whole numbers.
        contrast: float64 (N,), mean gray on the side of smaller x minus that of larger x, -255..255.
    """

    ends: F64
    contrast: F64

    def __len__(self) -> int:
        return len(self.ends)

    @property
    def length(self) -> F64:
        """float64 (N,), px."""
        lengths: F64 = np.hypot(*np.moveaxis(self.ends[:, 1] - self.ends[:, 0], 1, 0))
        return lengths

    @property
    def height(self) -> F64:
        """float64 (N,), rows from the upper to the lower end, px."""
        heights: F64 = self.ends[:, 1, 1] - self.ends[:, 0, 1]
        return heights

    @property
    def orientation(self) -> F64:
        """float64 (N,), angle from the x axis to the direction down the segment, radians, 0..pi."""
        dx, dy = np.moveaxis(self.ends[:, 1] - self.ends[:, 0], 1, 0)
        angles: F64 = np.arctan2(dy, dx)
        return angles

    @property
    def midpoint(self) -> F64:
        """float64 (N, 2), (x, y) in px."""
        middle: F64 = self.ends.mean(axis=1)
        return middle

    def columns(self, rows: F64) -> F64:
        """x at which the line of each segment crosses a row, px.

        Args:
            rows: float64, broadcasts with (N,).
        """
        (x0, y0), (x1, y1) = np.moveaxis(self.ends, 0, 2)
        crossing: F64 = x0 + (rows - y0) * (x1 - x0) / (y1 - y0)
        return crossing

    def at(self, rows: npt.NDArray[np.intp]) -> F64:
        """float64 (N, 2), the point (x, y) of each segment in the given row; rows (N,)."""
        points: F64 = np.stack((self.columns(rows.astype(np.float64)), rows), axis=1)
        return points

    def take(self, indices: npt.NDArray[np.intp]) -> LineSegments:
        """The segments of these indices."""
        return LineSegments(self.ends[indices], self.contrast[indices])


def detect_segments(image: U8) -> LineSegments:
    """Straight edges, by the detector LSD (von Gioi, Jakubowicz, Morel and Randall 2010) of OpenCV.

    Segments shorter than 10 px are skipped, and those less than 20 degrees from the rows, which do not determine the
    disparity.

    Args:
        image: uint8 (H, W).
    """
    found = cv2.createLineSegmentDetector().detect(image)[0]
    ends = np.empty((0, 2, 2)) if found is None else found.reshape(-1, 2, 2) + CENTER_SHIFT_PX
    upside_down = ends[:, 0, 1] > ends[:, 1, 1]
    ends[upside_down] = ends[upside_down, ::-1]
    dx, dy = np.moveaxis(ends[:, 1] - ends[:, 0], 1, 0)
    length = np.hypot(dx, dy)
    ends = ends[(length >= MIN_LENGTH_PX) & (dy >= length * np.sin(np.radians(MIN_SLOPE_DEG)))]
    return LineSegments(ends, _contrast(image, ends))


def common_rows(left: LineSegments, right: LineSegments) -> tuple[F64, F64]:
    """First and last row common to each pair of segments, float64 (L, R) each; last < first if there is none."""
    first: F64 = np.maximum(left.ends[:, None, 0, 1], right.ends[None, :, 0, 1])
    last: F64 = np.minimum(left.ends[:, None, 1, 1], right.ends[None, :, 1, 1])
    return first, last


def line_similarity(left: LineSegments, right: LineSegments, min_disparity: float, max_disparity: float) -> F64:
    """S = 1 / (w0 (l_l - l_r)^2 + w1 (theta_l - theta_r)^2 + w2 |m_l - m_r|^2 + w3 (c_l - c_r)^2).

    The measure of Trucco and Verri (1998), section 7.2.3, from length l, orientation theta, midpoint m and contrast c.
    Weights are inverse variances, so the sum is dimensionless: 4 is two standard deviations.

    - Orientations are those of lines: they differ by at most pi / 2.
    - Midpoints of a rectified pair differ by the disparity: columns count by their distance from the search range, rows
      by their difference.
    - Contrast is signed: an edge from dark to bright does not match one from bright to dark.

    Args:
        left, right: L and R segments.
        min_disparity, max_disparity: disparities searched, px.

    Returns:
        float64 (L, R), above 0; infinite for equal segments.
    """
    length = left.length[:, None] - right.length
    orientation = np.abs(left.orientation[:, None] - right.orientation)
    orientation = np.minimum(orientation, np.pi - orientation)
    column, row = np.moveaxis(left.midpoint[:, None] - right.midpoint, 2, 0)
    column = column - np.clip(column, min_disparity, max_disparity)
    contrast = left.contrast[:, None] - right.contrast
    dissimilarity: F64 = (
        (length / LENGTH_SIGMA_PX) ** 2
        + (orientation / ORIENTATION_SIGMA_RAD) ** 2
        + (column**2 + row**2) / MIDPOINT_SIGMA_PX**2
        + (contrast / CONTRAST_SIGMA) ** 2
    )
    with np.errstate(divide="ignore"):
        similarity: F64 = 1 / dissimilarity
    return similarity


def _contrast(image: U8, ends: F64) -> F64:
    """Mean difference of the gray values beside each segment, float64 (N,)."""
    if not len(ends):
        return np.empty(0)
    along = (np.arange(CONTRAST_SAMPLES) + 0.5) / CONTRAST_SAMPLES
    run = ends[:, 1] - ends[:, 0]
    points = ends[:, None, 0] + along[:, None] * run[:, None]
    normal = np.stack((-run[:, 1], run[:, 0]), axis=1) / np.hypot(run[:, 0], run[:, 1])[:, None]
    offset = CONTRAST_OFFSET_PX * normal[:, None]
    smaller_x, larger_x = (_mean_gray(image, points + side) for side in (offset, -offset))
    return smaller_x - larger_x


def _mean_gray(image: U8, points: F64) -> F64:
    """Means over axis 1 of the gray values at (N, K, 2) points, bilinear, with replicated border."""
    sampled = cv2.remap(image, points.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    means: F64 = sampled.mean(axis=1, dtype=np.float64)
    return means

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Triangulation of a rectified pair: disparity to point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

__all__ = ["Triangulation", "pixel_depth"]


@dataclass(frozen=True)
class Triangulation:
    """Parameters that convert a disparity of the left rectified image to a point in its optical frame.

    Z = f B / (d - doffs), X = (u - cx) Z / fx, Y = (v - cy) Z / fy, with doffs = cx_left - cx_right
    (Trucco and Verri, Introductory Techniques for 3-D Computer Vision, 1998, section 7.1, extended by the offset).

    Attributes:
        f_px, fy_px: focal lengths along x and y, pixels.
        cx_px, cy_px: principal point of the left camera, pixels.
        baseline_m: distance of the optical centers, meters.
        doffs_px: cx_left - cx_right; 0 for disparities from which it is already subtracted.
    """

    f_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    doffs_px: float

    @classmethod
    def from_rig(cls, rig: StereoRig) -> Triangulation:
        """Triangulation of a rig, for disparities d = x_left - x_right."""
        return cls(rig.f_px, rig.fy_px, rig.cx_left, rig.cy, rig.baseline_m, rig.doffs_px)

    def points(self, left_px: F64, right_px: F64) -> F64:
        """The points of matches of a rectified pair.

        Args:
            left_px, right_px: float64 (N, 2), px; only x of the right points is used.

        Returns:
            float64 (N, 3): X, Y, Z in the left rectified frame, meters; NaN where the disparity is not above doffs.
        """
        x, y = left_px.T
        d = x - right_px[:, 0] - self.doffs_px
        depth = self.f_px * self.baseline_m / np.where(d > 0, d, np.nan)
        return np.stack(((x - self.cx_px) / self.f_px * depth, (y - self.cy_px) / self.fy_px * depth, depth), axis=1)


@compiled()
def pixel_depth(disparity_px: np.float32, doffs_px: np.float32, f_baseline: np.float32) -> np.float32:
    """Z of one disparity, meters; NaN where it is NaN or not above the offset."""
    d = disparity_px - doffs_px
    return f_baseline / d if d > np.float32(0) else np.float32(np.nan)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much of the world a camera sees, lens distortion included."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.camera_model import CameraModel
from stereo_depth_ros.geometry.correspondences import undistort_points
from stereo_depth_ros.types import F64

__all__ = ["FieldOfView", "field_of_view"]

_STEPS = 50  # of Newton's method
_TOLERANCE_PX = 0.01  # within which a pixel comes back from its ray


@dataclass(frozen=True)
class FieldOfView:
    """Angles from edge to edge through the principal point, and from corner to corner, degrees.

    NaN where the distortion model has no ray for an edge or corner.
    """

    horizontal_deg: float
    vertical_deg: float
    diagonal_deg: float


def field_of_view(camera: CameraModel) -> FieldOfView:
    """That of the raw picture; of the rectified one for ``camera.rectified()``.

    An angle is the sum of those of its two ends from the optical axis, so that it may exceed 180 degrees. The picture
    ends half a pixel beyond the centres of its outermost pixels. The diagonal is the larger one.
    """
    left, top, right, bottom = -0.5, -0.5, camera.width - 0.5, camera.height - 0.5
    cx, cy = camera.K[0, 2], camera.K[1, 2]
    ends = [(left, cy), (right, cy), (cx, top), (cx, bottom)]
    corners = [(left, top), (right, bottom), (left, bottom), (right, top)]
    horizontal, vertical, falling, rising = (
        np.degrees(_angles_from_axis(np.array(ends + corners), camera)).reshape(4, 2).sum(axis=1).tolist()
    )
    return FieldOfView(horizontal, vertical, float(np.maximum(falling, rising)))


def _angles_from_axis(points_px: F64, camera: CameraModel) -> F64:
    """float64 (N,), radians; NaN where there is no ray."""
    if camera.distortion_model == "equidistant":
        return _fisheye_angles(points_px, camera)
    scaled = (undistort_points(points_px, camera) - camera.K[:2, 2]) / [camera.K[0, 0], camera.K[1, 1]]
    rays = np.column_stack((scaled, np.ones(len(scaled))))
    seen = np.isfinite(scaled).all(axis=1)
    rays[~seen] = 0, 0, 1
    D = camera.D if camera.D.size else np.zeros(5)
    back = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, D)[0][:, 0]
    # Beyond the turning point of a distortion the way back from a pixel ends somewhere else
    seen &= np.abs(back - points_px).max(axis=1) < _TOLERANCE_PX
    return np.where(seen, np.arctan(np.hypot(*scaled.T)), np.nan)


def _fisheye_angles(points_px: F64, camera: CameraModel) -> F64:
    """theta of r = theta (1 + k1 theta^2 + ... + k4 theta^8), by Newton's method (Kannala and Brandt 2006)."""
    offsets = (points_px - camera.K[:2, 2]) / [camera.K[0, 0], camera.K[1, 1]]
    radius = np.hypot(*offsets.T)
    polynomial = np.polynomial.Polynomial(np.insert(np.insert(camera.D, 0, 1.0), range(5), 0.0))
    slope = polynomial.deriv()
    theta = radius.copy()
    for _ in range(_STEPS):
        theta = np.clip(theta - (polynomial(theta) - radius) / slope(theta), 0, np.pi)
    seen = np.abs(polynomial(theta) - radius) * camera.K[0, 0] < _TOLERANCE_PX
    # a root beyond the turning point belongs to another pixel
    rising = np.array([(slope(np.linspace(0, angle, 100)) > 0).all() for angle in theta])
    return np.where(seen & rising, theta, np.nan)

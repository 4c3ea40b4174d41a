# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""In which direction a camera sees a pixel, lens distortion included, beyond 90 degrees off the axis too."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.correspondences import undistort_points

__all__ = ["camera_rays"]

_STEPS = 50  # of Newton's method
_TOLERANCE_PX = 0.01  # within which a pixel comes back from its ray


def camera_rays(points_px: F64, camera: CameraModel) -> F64:
    """float64 (N, 3), of length 1, x right, y down, z forward; NaN where the distortion model has no ray for a pixel.

    Args:
        points_px: float64 (N, 2) of the raw image.
    """
    if camera.distortion_model == "equidistant":
        return _fisheye_rays(points_px, camera)
    scaled = (undistort_points(points_px, camera) - camera.K[:2, 2]) / [camera.K[0, 0], camera.K[1, 1]]
    rays = np.column_stack((scaled, np.ones(len(scaled))))
    seen = np.isfinite(scaled).all(axis=1)
    rays[~seen] = 0, 0, 1
    D = camera.D if camera.D.size else np.zeros(5)
    back = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, D)[0][:, 0]
    # Beyond the turning point of a distortion the way back from a pixel ends somewhere else
    seen &= np.abs(back - points_px).max(axis=1) < _TOLERANCE_PX
    rays[~seen] = np.nan
    unit: F64 = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return unit


def _fisheye_rays(points_px: F64, camera: CameraModel) -> F64:
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
    rising = np.array([(slope(np.linspace(0, angle, 100)) > 0).all() for angle in theta], bool)
    across = offsets * (np.sin(theta) / np.maximum(radius, 1e-12))[:, None]
    rays = np.column_stack((across, np.cos(theta)))
    rays[~(seen & rising)] = np.nan
    return rays

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Removal of lens distortion: rays of raw pixels, undistorted pixels, rectified pixels."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import homogeneous

__all__ = ["camera_rays", "normalized_points", "rectify_points", "undistort_points"]

_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10)
_MAX_TANGENT = 300.0  # 89.8 degrees off the axis; OpenCV sets points that no pinhole camera can see to +-1e6
_STEPS = 50  # largest number of steps of Newton's method
_TOLERANCE_PX = 0.01  # largest error of the projection of the ray of a pixel


def camera_rays(points_px: F64, camera: CameraModel) -> F64:
    """Rays of raw pixels, float64 (N, 3) of length 1, x right, y down, z forward; NaN where the model has no ray.

    Rays of a fisheye may be more than 90 degrees off the axis.

    Args:
        points_px: float64 (N, 2) of the raw image.
    """
    if not len(points_px):
        return np.empty((0, 3))
    if camera.distortion_model == "equidistant":
        return _fisheye_rays(points_px, camera)
    scaled = normalized_points(points_px, camera.distortion_model, camera.K, camera.D)
    rays = np.column_stack((scaled, np.ones(len(scaled))))
    valid = np.isfinite(scaled).all(axis=1)
    rays[~valid] = 0, 0, 1
    D = camera.D if camera.D.size else np.zeros(5)
    projected = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, D)[0][:, 0]
    # Beyond the distortion range the inverse converges to another pixel's ray
    valid &= np.abs(projected - points_px).max(axis=1) < _TOLERANCE_PX
    rays[~valid] = np.nan
    unit: F64 = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return unit


def normalized_points(points_px: F64, distortion_model: str, K: F64, D: F64) -> F64:
    """x / z and y / z of the rays of raw pixels, float64 (N, 2); NaN where they are 90 degrees off the axis or more.

    Args:
        points_px: float64 (N, 2).
        distortion_model: "plumb_bob", "rational_polynomial" or "equidistant".
        K: float64 (3, 3), px.
        D: float64 (n,), coefficients of the model.
    """
    if not len(points_px):
        return np.empty((0, 2))
    if distortion_model != "equidistant" and not D.any():
        return np.asarray((points_px - K[:2, 2]) / [K[0, 0], K[1, 1]], np.float64)
    pixels = np.ascontiguousarray(points_px[:, None])
    if distortion_model == "equidistant":
        found = cv2.fisheye.undistortPoints(pixels, K, D, criteria=_CRITERIA)
    elif hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
        found = cv2.undistortPointsIter(pixels, K, D, np.identity(3), np.identity(3), _CRITERIA)
    else:
        found = cv2.undistortPoints(pixels, K, D, None, np.identity(3), np.identity(3), _CRITERIA)
    points: F64 = found[:, 0].copy()
    points[np.abs(points).max(axis=1) > _MAX_TANGENT] = np.nan
    return points


def undistort_points(points_px: F64, camera: CameraModel) -> F64:
    """Pixels of a camera with the same K and no distortion, from points of a raw image.

    Args:
        points_px: float64 (N, 2), px.

    Returns:
        float64 (N, 2), px; NaN where a point is 90 degrees off the axis or more.
    """
    if camera.distortion_model != "equidistant" and not camera.D.any():
        return points_px.copy()
    points = normalized_points(points_px, camera.distortion_model, camera.K, camera.D)
    return np.asarray(points * [camera.K[0, 0], camera.K[1, 1]] + camera.K[:2, 2], np.float64)


def rectify_points(points_px: F64, camera: CameraModel) -> F64:
    """Raw pixels, float64 (N, 2), as pixels of the rectified camera (R, P); NaN as of :func:`normalized_points`."""
    points = normalized_points(points_px, camera.distortion_model, camera.K, camera.D)
    rectified: F64 = homogeneous(points) @ (camera.P[:, :3] @ camera.R).T
    return rectified[:, :2] / rectified[:, 2:]


def _fisheye_rays(points_px: F64, camera: CameraModel) -> F64:
    """theta of r = theta (1 + k1 theta^2 + ... + k4 theta^8), by Newton's method (Kannala and Brandt 2006)."""
    offsets = (points_px - camera.K[:2, 2]) / [camera.K[0, 0], camera.K[1, 1]]
    radius = np.hypot(*offsets.T)
    polynomial = np.polynomial.Polynomial(np.insert(np.insert(camera.D, 0, 1.0), range(5), 0.0))
    slope = polynomial.deriv()
    theta = radius.copy()
    for _ in range(_STEPS):
        theta = np.clip(theta - (polynomial(theta) - radius) / slope(theta), 0, np.pi)
    valid = np.abs(polynomial(theta) - radius) * camera.K[0, 0] < _TOLERANCE_PX
    # A root beyond the distortion range belongs to another pixel
    increasing = np.array([(slope(np.linspace(0, angle, 100)) > 0).all() for angle in theta], bool)
    across = offsets * (np.sin(theta) / np.maximum(radius, 1e-12))[:, None]
    rays = np.column_stack((across, np.cos(theta)))
    rays[~(valid & increasing)] = np.nan
    return rays

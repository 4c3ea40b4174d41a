# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Epipolar geometry: fundamental matrices of known cameras, epipoles, epipolar lines and distances from them.

All functions apply to pixels with a fundamental matrix F, and to camera coordinates (x / z, y / z) with an essential
matrix E. x_right^T F x_left = 0; the transpose exchanges the cameras.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.relative_pose import RelativePose

__all__ = [
    "camera_coordinates",
    "epipolar_lines",
    "epipoles",
    "fundamental_from_essential",
    "fundamental_from_pose",
    "homogeneous",
    "sampson_distance",
    "symmetric_epipolar_distance",
]


def fundamental_from_essential(E: F64, K_left: F64, K_right: F64) -> F64:
    """float64 (3, 3): F = K_right^-T E K_left^-1 (Hartley and Zisserman 2004, eq. 9.12), for pixels without distortion.

    Args:
        E: float64 (3, 3), essential matrix.
        K_left, K_right: float64 (3, 3), intrinsics, px.
    """
    F: F64 = np.linalg.inv(K_right).T @ E @ np.linalg.inv(K_left)
    return F


def fundamental_from_pose(pose: RelativePose, K_left: F64, K_right: F64) -> F64:
    """float64 (3, 3): the fundamental matrix of two cameras, for pixels without distortion."""
    return fundamental_from_essential(pose.essential, K_left, K_right)


def epipoles(F: F64) -> tuple[F64, F64]:
    """Left and right epipole, the projection of the other camera's center: F e_left = 0 and F^T e_right = 0.

    Returns:
        Two float64 (3,), homogeneous, of length 1, the last value not negative: (x, y, w) is the point (x / w, y / w).
        w is 0 for an epipole at infinity, as in a rectified pair.
    """
    U, _, Vt = np.linalg.svd(F)
    left, right = (e * (1.0 if e[2] >= 0 else -1.0) for e in (Vt[2], U[:, 2]))
    return left, right


def epipolar_lines(F: F64, left: F64) -> F64:
    """Epipolar lines of left points in the right image; with F.T, of right points in the left image.

    Args:
        left: float64 (N, 2).

    Returns:
        float64 (N, 3): (a, b, c) with a x + b y + c = 0 and a^2 + b^2 = 1. NaN for the epipole, which has no line.
    """
    lines = homogeneous(left) @ F.T
    norm = np.hypot(lines[:, 0], lines[:, 1])
    # The line of the epipole is 0 up to rounding
    defined = norm > 1e-14 * np.linalg.norm(F) * np.linalg.norm(homogeneous(left), axis=1)
    unit: F64 = lines / np.where(defined, norm, np.nan)[:, None]
    return unit


def symmetric_epipolar_distance(F: F64, left: F64, right: F64) -> F64:
    """float64 (N,): mean distance of both points, float64 (N, 2) each, from the epipolar line of the other one.

    In the unit of the points; NaN where one of the points is an epipole.
    """
    in_right = np.abs(np.einsum("ij,ij->i", homogeneous(right), epipolar_lines(F, left)))
    in_left = np.abs(np.einsum("ij,ij->i", homogeneous(left), epipolar_lines(F.T, right)))
    mean: F64 = (in_left + in_right) / 2
    return mean


def sampson_distance(F: F64, left: F64, right: F64) -> F64:
    """float64 (N,): Sampson distance of both points, float64 (N, 2) each, in the unit of the points.

    The first-order geometric error: the root of the sum of squared displacements of both points to the nearest match
    that satisfies F (Sampson 1982; Hartley and Zisserman 2004, eq. 11.9).
    """
    x_left, x_right = homogeneous(left), homogeneous(right)
    in_right, in_left = x_left @ F.T, x_right @ F
    slope = np.hypot(np.hypot(*in_right[:, :2].T), np.hypot(*in_left[:, :2].T))
    # For a match of two epipoles 0 / tiny is 0
    distance: F64 = np.abs(np.einsum("ij,ij->i", x_right, in_right)) / np.maximum(slope, np.finfo(np.float64).tiny)
    return distance


def camera_coordinates(points_px: F64, K: F64) -> F64:
    """float64 (N, 2), (x / z, y / z) of pixels without distortion, float64 (N, 2), for intrinsics float64 (3, 3)."""
    rays: F64 = homogeneous(points_px) @ np.linalg.inv(K).T
    return rays[:, :2]


def homogeneous(points: npt.NDArray[np.float64]) -> F64:
    """float64 (N, 3): (x, y, 1) of float64 (N, 2)."""
    return np.column_stack((points, np.ones(len(points))))

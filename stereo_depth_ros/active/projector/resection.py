# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Resection: the matrix of a projector, an inverse camera, from the pixels that light points of known position."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import homogeneous

__all__ = ["Resection", "projection_errors_px", "resect"]

MIN_POINTS = 6  # two equations each, for the 11 degrees of freedom of P
# Singular values, the second smallest relative to the largest: that of points of one plane is 0 but for noise
_LEAST_RANK = 3e-4


class Resection(NamedTuple):
    """A pinhole P = K [R | T].

    Attributes:
        P: float64 (3, 4), from meters to px.
        rms_px: root mean square distance of the projected points from their pixels.
    """

    P: F64
    rms_px: float

    def decomposed(self) -> tuple[F64, F64, F64]:
        """K, R and T, float64 (3, 3), (3, 3), (3,), with K[2, 2] = 1 and the skew left out of K.

        Hartley and Zisserman, Multiple View Geometry, 2004, section 6.2.4, by the QR decomposition of the inverse.
        """
        Q, U = np.linalg.qr(np.linalg.inv(self.P[:, :3]))
        signs = np.diag(np.where(np.diag(U) < 0, -1.0, 1.0))
        R = np.asarray((Q @ signs).T, np.float64)
        K = np.asarray(np.linalg.inv(signs @ U), np.float64)
        T = np.asarray(np.linalg.solve(K, self.P[:, 3]), np.float64)
        if np.linalg.det(R) < 0:
            R, T = -R, -T
        K = K / K[2, 2]
        K[0, 1] = 0.0
        return K, R, T


def resect(points_m: F64, image_px: F64) -> Resection:
    """The pinhole of least algebraic error, by the direct linear transformation.

    Hartley and Zisserman, Multiple View Geometry, 2004, algorithm 7.1, its linear part: points and pixels are
    normalized, P is the singular vector of the smallest singular value of x (P3 X) = P1 X, y (P3 X) = P2 X.

    Args:
        points_m: float64 (N, 3), N at least 6, not all in one plane.
        image_px: float64 (N, 2).

    Raises:
        CalibrationError: too few points, or all near one plane, so that P is not determined.
    """
    if len(points_m) < MIN_POINTS:
        raise CalibrationError(
            f"{len(points_m)} points do not determine the projector, at least {MIN_POINTS} are needed",
            value=len(points_m),
            limit=MIN_POINTS,
            remedy="show the board where camera and projector see all of it",
        )
    to_points, to_pixels = _normalization(points_m), _normalization(image_px)
    X, x = homogeneous(points_m) @ to_points.T, homogeneous(image_px) @ to_pixels.T
    zeros = np.zeros_like(X)
    A = np.concatenate((np.hstack((X, zeros, -x[:, :1] * X)), np.hstack((zeros, X, -x[:, 1:2] * X))))
    _, sizes, directions = np.linalg.svd(A, full_matrices=False)
    if sizes[-2] < _LEAST_RANK * sizes[0]:
        raise CalibrationError(
            f"the poses of the board are nearly one plane (rank measure {sizes[-2] / sizes[0]:.2g}, limit "
            f"{_LEAST_RANK:g}), which does not determine the projector",
            value=float(sizes[-2] / sizes[0]),
            limit=_LEAST_RANK,
            remedy="tilt the board by 30 degrees between the poses, and move it nearer and farther",
        )
    P = np.linalg.inv(to_pixels) @ directions[-1].reshape(3, 4) @ to_points
    P /= np.linalg.norm(P[2, :3])
    if np.median(homogeneous(points_m) @ P[2]) < 0:
        P = -P
    return Resection(P, float(np.sqrt(np.square(projection_errors_px(P, points_m, image_px)).mean())))


def projection_errors_px(P: F64, points_m: F64, image_px: F64) -> F64:
    """Distances of projected points from their pixels, float64 (N,), px; infinite for points behind the projector."""
    projected = homogeneous(points_m) @ P.T
    ahead = projected[:, 2] > 0
    pixels = projected[:, :2] / np.where(ahead, projected[:, 2], 1.0)[:, None]
    return np.where(ahead, np.linalg.norm(pixels - image_px, axis=1), np.inf)


def _normalization(points: F64) -> F64:
    """The similarity, float64 (n + 1, n + 1), to mean 0 and root mean square distance sqrt(n)."""
    count = points.shape[1]
    center = points.mean(axis=0)
    scale = np.sqrt(count) / max(float(np.sqrt(np.square(points - center).sum(axis=1).mean())), 1e-300)
    similarity = np.diag([*[scale] * count, 1.0])
    similarity[:count, count] = -scale * center
    return similarity

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The normalized eight-point algorithm, and checks for degenerate point configurations."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import homogeneous

__all__ = ["check_matches", "eight_point", "enforce_rank_2", "epipolar_equations", "unit_scale"]

MIN_POINTS = 8
MIN_WIDTH = 0.01  # of the point cloud, as a share of its length; below that it is collinear
_REMEDY = "use matches that are spread over both images and several depths, from cameras at two positions"


def eight_point(left: F64, right: F64) -> F64:
    """The fundamental matrix of matches without outliers, by linear least squares (Hartley 1997).

    Points are normalized to mean 0 and root mean square distance sqrt(2), and the solution is replaced by the nearest
    matrix of rank 2 before the normalization is undone. Points in camera coordinates give the essential matrix, its two
    singular values not yet equal.

    Args:
        left, right: float64 (N, 2), N >= 8, px.

    Returns:
        float64 (3, 3), x_right^T F x_left = 0, rank 2, Frobenius norm 1, the entry of largest size positive.

    Raises:
        CalibrationError: fewer than eight different matches, points that are not finite, or points that are
            coincident, collinear, or so near to one plane (or seen from one position) that other matrices fit too.
    """
    check_matches(left, right)
    to_left, to_right = _normalization(left), _normalization(right)
    x_left, x_right = homogeneous(left) @ to_left.T, homogeneous(right) @ to_right.T
    # Eight equations give the ninth direction only with full matrices; for many they would be N x N
    _, singular, Vt = np.linalg.svd(epipolar_equations(x_left, x_right), full_matrices=len(left) == MIN_POINTS)
    _check_parallax(x_left, x_right)
    _check_unique(singular, len(left))
    return unit_scale(to_right.T @ enforce_rank_2(Vt[8].reshape(3, 3)) @ to_left)


def epipolar_equations(x_left: F64, x_right: F64) -> F64:
    """float64 (..., N, 9): rows whose product with the nine values of F is 0, from homogeneous float64 (..., N, 3)."""
    products: F64 = x_right[..., :, None] * x_left[..., None, :]
    return products.reshape(*products.shape[:-2], 9)


def enforce_rank_2(F: F64) -> F64:
    """float64 (..., 3, 3): the nearest matrices of rank 2 in the Frobenius norm."""
    U, singular, Vt = np.linalg.svd(F)
    singular[..., 2] = 0
    nearest: F64 = (U * singular[..., None, :]) @ Vt
    return nearest


def unit_scale(F: F64) -> F64:
    """The same matrix, float64 (3, 3), with Frobenius norm 1 and the entry of largest size positive."""
    largest = F.ravel()[np.abs(F).argmax()]
    unit: F64 = F * (np.sign(largest) / np.linalg.norm(F))
    return unit


def check_matches(left: F64, right: F64) -> None:
    """Raise CalibrationError where points, float64 (N, 2) each, are too few, not finite, coincident or collinear."""
    if left.shape != right.shape or left.shape[1:] != (2,):
        raise CalibrationError(
            f"left and right points have shapes {left.shape} and {right.shape}, not both (N, 2)",
            value=(left.shape, right.shape),
            remedy="pass pairs of points",
        )
    if not np.isfinite(left).all() or not np.isfinite(right).all():
        raise CalibrationError("some of the matches have points that are not finite", remedy="remove them")
    different = len(np.unique(np.hstack((left, right)), axis=0))
    if different < MIN_POINTS:
        raise CalibrationError(
            f"{different} different matches of {len(left)}, the fundamental matrix needs {MIN_POINTS}",
            value=different,
            limit=MIN_POINTS,
            remedy=_REMEDY,
        )
    for points, label in ((left, "left"), (right, "right")):
        _check_spread(points, label)


def _check_spread(points: F64, label: str) -> None:
    length, width = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    # Rounding of the coordinates gives coincident points a length above 0
    if length <= 1e-9 * np.abs(points).max():
        raise CalibrationError(
            f"the {len(points)} {label} points are coincident",
            value=float(length),
            limit=float(1e-9 * np.abs(points).max()),
            remedy=_REMEDY,
        )
    if width < MIN_WIDTH * length:
        raise CalibrationError(
            f"the {len(points)} {label} points are collinear: they spread {width:.3g} across their line and "
            f"{length:.3g} along it, limit {MIN_WIDTH:g} of that",
            value=float(width / length),
            limit=MIN_WIDTH,
            remedy=_REMEDY,
        )


def _normalization(points: F64) -> F64:
    """float64 (3, 3): moves the mean to 0 and scales the root mean square distance to sqrt(2)."""
    mean = points.mean(axis=0)
    scale = np.sqrt(2 / np.mean(((points - mean) ** 2).sum(axis=1)))
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])


def _check_parallax(x_left: F64, x_right: F64) -> None:
    """Points of one plane, and points seen from one position, are mapped by a homography.

    As few points do not determine their noise, a minimum parallax is required: 1.25 % of the spread of eight points,
    and less for more points.
    """
    H = cv2.findHomography(x_left[:, :2], x_right[:, :2], 0)[0]
    if H is None:
        return
    mapped = x_left @ H.T
    parallax = np.sqrt(np.mean(((mapped[:, :2] / mapped[:, 2:] - x_right[:, :2]) ** 2).sum(axis=1)) / 2)
    limit = 0.1 / len(x_left)
    if parallax < limit:
        raise CalibrationError(
            f"one homography maps the {len(x_left)} left points to the right ones within {parallax:.2g} of their "
            f"spread, limit {limit:.2g}: they are coplanar, or the camera only rotated",
            value=float(parallax),
            limit=limit,
            remedy=_REMEDY,
        )


def _check_unique(singular: F64, count: int) -> None:
    """The second best solution must fit clearly worse than the best one; the limit is larger for few points.

    Args:
        singular: float64 (8,) for eight points, else (9,): singular values of the equations, in descending order.
    """
    more = count - MIN_POINTS
    best = max(singular[8] if more else 0.0, 1e-8 * singular[0])  # below that is rounding
    gap, limit = singular[7] / best, 2 + 20 / max(more, 2)
    if gap <= limit:
        raise CalibrationError(
            f"the {count} matches allow several fundamental matrices: the residual of the second best is {gap:.3g} "
            f"times that of the best, limit {limit:.3g}: coplanar or collinear points, a camera that only rotated, or "
            "noise above the parallax",
            value=float(gap),
            limit=limit,
            remedy=_REMEDY,
        )

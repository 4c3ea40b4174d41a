# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The normalized eight-point algorithm, and which points say nothing about the fundamental matrix."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import homogeneous

__all__ = ["check_matches", "eight_point", "enforce_rank_2", "epipolar_equations", "unit_scale"]

MIN_POINTS = 8
MIN_WIDTH = 0.01  # of the cloud of points, as a share of its length; below that it is a line
_REMEDY = "take matches that are spread over both images and over several depths, from cameras in two places"


def eight_point(left: F64, right: F64) -> F64:
    """The fundamental matrix of matches without wrong ones, by least squares (Hartley 1997).

    Both clouds of points are moved to their mean and scaled to the root mean square distance sqrt(2); the solution is
    replaced by the nearest matrix of rank 2 before that is undone. Of points in camera coordinates it gives the
    essential matrix, its two singular values not yet equal.

    Args:
        left, right: float64 (N, 2), N >= 8, px.

    Returns:
        float64 (3, 3), x_right^T F x_left = 0, rank 2, Frobenius norm 1, the entry of largest size positive.

    Raises:
        CalibrationError: fewer than eight different matches, points that are not finite, or points that are
            coincident, collinear, or so near to one plane (or seen from one place) that they allow other matrices.
    """
    check_matches(left, right)
    to_left, to_right = _normalization(left), _normalization(right)
    x_left, x_right = homogeneous(left) @ to_left.T, homogeneous(right) @ to_right.T
    # Eight equations leave the ninth direction out unless all are asked for; of many, N x N values are not needed
    _, singular, Vt = np.linalg.svd(epipolar_equations(x_left, x_right), full_matrices=len(left) == MIN_POINTS)
    _check_parallax(x_left, x_right)
    _check_unique(singular, len(left))
    return unit_scale(to_right.T @ enforce_rank_2(Vt[8].reshape(3, 3)) @ to_left)


def epipolar_equations(x_left: F64, x_right: F64) -> F64:
    """float64 (..., N, 9): the rows that vanish against the nine values of F, from homogeneous float64 (..., N, 3)."""
    products: F64 = x_right[..., :, None] * x_left[..., None, :]
    return products.reshape(*products.shape[:-2], 9)


def enforce_rank_2(F: F64) -> F64:
    """float64 (..., 3, 3): the nearest matrices of rank 2, by Frobenius norm."""
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
            f"left and right points have shapes {left.shape} and {right.shape}, both are (N, 2): give pairs of points"
        )
    if not np.isfinite(left).all() or not np.isfinite(right).all():
        raise CalibrationError("points that are not finite among the matches: leave them out")
    different = len(np.unique(np.hstack((left, right)), axis=0))
    if different < MIN_POINTS:
        raise CalibrationError(
            f"{different} different matches of {len(left)}, the fundamental matrix takes {MIN_POINTS}: {_REMEDY}"
        )
    for points, label in ((left, "left"), (right, "right")):
        _check_spread(points, label)


def _check_spread(points: F64, label: str) -> None:
    length, width = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    # Rounding of coordinates alone gives coincident points a length
    if length <= 1e-9 * np.abs(points).max():
        raise CalibrationError(f"the {len(points)} {label} points are coincident: {_REMEDY}")
    if width < MIN_WIDTH * length:
        raise CalibrationError(
            f"the {len(points)} {label} points are collinear: they spread {width:.3g} across their line and "
            f"{length:.3g} along it, limit {MIN_WIDTH:g} of that: {_REMEDY}"
        )


def _normalization(points: F64) -> F64:
    """float64 (3, 3): moves the mean to 0 and scales the root mean square distance to sqrt(2)."""
    mean = points.mean(axis=0)
    scale = np.sqrt(2 / np.mean(((points - mean) ** 2).sum(axis=1)))
    return np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1]])


def _check_parallax(x_left: F64, x_right: F64) -> None:
    """Points of one plane, and points seen from one place, are those that a homography maps.

    Few points do not tell their noise, so that some parallax is asked of them: 1.25 % of the spread of eight points,
    and the less, the more there are.
    """
    H = cv2.findHomography(x_left[:, :2], x_right[:, :2], 0)[0]
    if H is None:
        return
    mapped = x_left @ H.T
    parallax = np.sqrt(np.mean(((mapped[:, :2] / mapped[:, 2:] - x_right[:, :2]) ** 2).sum(axis=1)) / 2)
    limit = 0.1 / len(x_left)
    if parallax < limit:
        raise CalibrationError(
            f"one homography maps the {len(x_left)} left points to the right ones, all but {parallax:.2g} of their "
            f"spread, limit {limit:.2g}: they lie in one plane, or the camera only turned: {_REMEDY}"
        )


def _check_unique(singular: F64, count: int) -> None:
    """The second best solution must be clearly worse than the best one; by how much, noise decides when points are few.

    Args:
        singular: float64 (8,) for eight points, else (9,): how badly the best nine solutions fit, worst first.
    """
    more = count - MIN_POINTS
    best = max(singular[8] if more else 0.0, 1e-8 * singular[0])  # below that is rounding
    gap, limit = singular[7] / best, 2 + 20 / max(more, 2)
    if gap <= limit:
        raise CalibrationError(
            f"the {count} matches allow several fundamental matrices: the second best fits {gap:.3g} times as badly as "
            f"the best, limit {limit:.3g}: points of one plane or line, a camera that only turned, or noise above the "
            f"parallax: {_REMEDY}"
        )

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Triangulation of matched points with any two known cameras.

Rectified pairs have a closed form: :meth:`stereo_depth_ros.core.triangulation.Triangulation.points`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.correspondences import Correspondences
from stereo_depth_ros.geometry.epipolar import homogeneous
from stereo_depth_ros.geometry.relative_pose import RelativePose, cross_matrix

__all__ = [
    "fundamental_from_cameras",
    "optimal_matches",
    "parallax",
    "triangulate_linear",
    "triangulate_midpoint",
    "triangulate_optimal",
]

MIN_PARALLAX_RAD = 1e-6  # of two rays: a thousandth of a pixel of a long lens, below the noise of matches
_ONE_RAY = 1e-9  # singular value, relative to the first, below which two rays are identical
_MAX_STEPS = 30  # of the optimal correction; 2 to 4 are usual
_CONVERGED_PX = 1e-9


def triangulate_linear(P_left: F64, P_right: F64, left_px: F64, right_px: F64) -> F64:
    """Linear triangulation: least squares of x (P3 X) = P1 X, y (P3 X) = P2 X of both images.

    Hartley and Zisserman, Multiple View Geometry, 2004, section 12.2. Exact for rays that intersect; for others the
    algebraic error has no meaning in the images, see :func:`triangulate_optimal`.

    Args:
        P_left, P_right: float64 (3, 4), cameras in any frame, projective ones too.
        left_px, right_px: float64 (N, 2), px of pinhole images.

    Returns:
        float64 (N, 4) of length 1, with (P_left X)_3 >= 0; the last coordinate is 0 for a point at infinity. NaN where
        the match is not finite, or where both rays are the baseline, on which every point is a solution.
    """
    matches = Correspondences(left_px, right_px)
    finite: npt.NDArray[np.bool_] = np.isfinite((matches.left_px + matches.right_px).sum(axis=1))
    matches = matches.take(finite)
    cameras = np.stack((P_left / np.linalg.norm(P_left), P_right / np.linalg.norm(P_right)))
    scale = np.linalg.norm(cameras, axis=(0, 1))  # a frame in which the columns weigh the same
    cameras /= scale
    rows = [
        points[:, i, None] * P[2] - P[i]
        for points, P in zip((matches.left_px, matches.right_px), cameras, strict=True)
        for i in (0, 1)
    ]
    A = np.stack(rows, axis=1)
    A /= np.linalg.norm(A, axis=2, keepdims=True)
    _, sizes, directions = np.linalg.svd(A)
    X = directions[:, 3] / scale
    X *= np.where(X @ P_left[2] < 0, -1, 1)[:, None] / np.linalg.norm(X, axis=1, keepdims=True)
    X[sizes[:, 2] <= _ONE_RAY * sizes[:, 0]] = np.nan
    return _spread(X, finite)


def triangulate_optimal(P_left: F64, P_right: F64, left_px: F64, right_px: F64) -> F64:
    """Optimal triangulation: least squared reprojection error in both images.

    The maximum-likelihood estimate for equal Gaussian noise; it is projectively invariant, so that it applies to
    projective cameras too (Hartley and Sturm, Triangulation, 1997). Arguments and result as of
    :func:`triangulate_linear`; NaN also where :func:`optimal_matches` does not converge.
    """
    nearest = optimal_matches(fundamental_from_cameras(P_left, P_right), left_px, right_px)
    return triangulate_linear(P_left, P_right, nearest.left_px, nearest.right_px)


def triangulate_midpoint(pose: RelativePose, left_rays: F64, right_rays: F64) -> F64:
    """Midpoint of the shortest segment between two rays (Trucco and Verri 1998, section 7.4.1).

    Args:
        pose: of calibrated cameras.
        left_rays, right_rays: float64 (N, 3), directions in the left and in the right camera, of any length.

    Returns:
        float64 (N, 3) in the left camera, in the unit of the pose. NaN where the rays are parallel, or closest to each
        other behind a camera.
    """
    T, rotated = pose.right_center, right_rays @ pose.R  # R^T p of every row
    normals = np.cross(left_rays, rotated)
    squared = np.einsum("ij,ij->i", normals, normals)
    lengths = np.linalg.norm(left_rays, axis=1) * np.linalg.norm(rotated, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along_left = np.einsum("ij,ij->i", np.cross(T, rotated), normals) / squared
        along_right = np.einsum("ij,ij->i", np.cross(T, left_rays), normals) / squared
    midpoint: F64 = (along_left[:, None] * left_rays + T + along_right[:, None] * rotated) / 2
    intersect = (np.sqrt(squared) > MIN_PARALLAX_RAD * lengths) & (along_left > 0) & (along_right > 0)
    midpoint[~intersect] = np.nan
    return midpoint


def optimal_matches(F: F64, left_px: F64, right_px: F64) -> Correspondences:
    """The matches that satisfy F exactly and are nearest to the given ones.

    Minimizes the sum of squared distances in both images (Lindstrom, Triangulation Made Easy, 2010, section 4): each
    step projects onto F along the normals of the epipolar lines of the previous one. Except where the noise is of the
    size of the distance to an epipole, this is the global minimum of Hartley and Sturm (1997), and it applies to
    rectified pairs too.

    Args:
        F: float64 (3, 3) with x_right^T F x_left = 0, of any scale.
        left_px, right_px: float64 (N, 2), px of pinhole images.

    Returns:
        N matches; NaN where the iteration does not converge, as for wrong matches near the epipoles.
    """
    found = Correspondences(left_px, right_px)
    F = F / np.linalg.norm(F)
    F22 = F[:2, :2]
    left, right = homogeneous(left_px), homogeneous(right_px)
    with np.errstate(divide="ignore", invalid="ignore"):  # points at infinity give NaN
        error = np.einsum("ni,ij,nj->n", right, F, left)
        start_right = left @ F[:2].T  # normals of the epipolar lines of the given points
        start_left = right @ F[:, :2]
        normal_left, normal_right = start_left, start_right
        step_left, step_right = np.zeros_like(found.left_px), np.zeros_like(found.right_px)
        for _ in range(_MAX_STEPS):
            a = np.einsum("ni,ij,nj->n", normal_right, F22, normal_left)
            b = (np.einsum("ni,ni->n", start_left, normal_left) + np.einsum("ni,ni->n", start_right, normal_right)) / 2
            length = error / (b + np.sqrt(b * b - a * error))
            before = step_left, step_right
            step_left, step_right = length[:, None] * normal_left, length[:, None] * normal_right
            moved = np.maximum(np.abs(step_left - before[0]), np.abs(step_right - before[1])).max(axis=1, initial=0)
            if not (moved > _CONVERGED_PX).any():
                break
            normal_left, normal_right = start_left - step_right @ F22, start_right - step_left @ F22.T
    diverged = ~(moved <= _CONVERGED_PX)
    step_left[diverged] = step_right[diverged] = np.nan
    return Correspondences(left_px - step_left, right_px - step_right)


def fundamental_from_cameras(P_left: F64, P_right: F64) -> F64:
    """float64 (3, 3) of length 1: F = [e']x P_right P_left^+ (Hartley and Zisserman 2004, equation 9.1)."""
    left_center = np.linalg.svd(P_left)[2][3]
    F: F64 = cross_matrix(P_right @ left_center) @ P_right @ np.linalg.pinv(P_left)
    return F / np.linalg.norm(F)


def parallax(points: F64, pose: RelativePose) -> F64:
    """Parallax angle between the two rays of a point, float64 (N,), radians; 0 at infinity and on the baseline.

    Args:
        points: float64 (N, 4), homogeneous, in the left camera, in the unit of the pose.
        pose: of calibrated cameras.
    """
    left_rays, baselines = points[:, :3], points[:, 3, None] * pose.right_center
    right_rays = left_rays - baselines
    sine = np.linalg.norm(np.cross(left_rays, baselines), axis=1)
    angle: F64 = np.arctan2(sine, np.einsum("ij,ij->i", left_rays, right_rays))
    return angle


def _spread(values: F64, chosen: npt.NDArray[np.bool_]) -> F64:
    """The values in the chosen rows, NaN in the others."""
    rows = np.full((len(chosen), *values.shape[1:]), np.nan)
    rows[chosen] = values
    return rows

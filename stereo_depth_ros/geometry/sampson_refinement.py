# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fundamental and essential matrices moved to where the Sampson distances of matches are least.

Distances d are summed as squares, or, with a scale c, as d^2 / (1 + (d / c)^2) (Geman and McClure 1985): a match
several scales away then pulls no more.
"""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import homogeneous
from stereo_depth_ros.geometry.relative_pose import cross_matrix

__all__ = ["common_scale", "refine_essential", "refine_fundamental", "robust_cost", "robust_scale"]

_ITERATIONS = 50
_SETTLED = 1e-10  # relative decrease of the sum of squares
_GENERATORS = np.stack([cross_matrix(axis) for axis in np.identity(3)])


def robust_scale(distances: F64) -> float:
    """A scale c for distances, float64 (N,), of right matches and some wrong ones: 2.5 standard deviations.

    The deviation is taken from the median; above 0 for matches without noise too.
    """
    return max(2.5 * 1.4826 * float(np.median(distances)), 1e-6)


def robust_cost(distances: F64, scale: float) -> float:
    """The sum that the refinements lower, of distances float64 (N,)."""
    squared = distances**2
    return float(np.sum(squared / (1 + squared / scale**2)))


def refine_fundamental(F: F64, left_px: F64, right_px: F64, scale_px: float = np.inf) -> F64:
    """The fundamental matrix of least Sampson distance near F, of rank 2 at every step.

    F = U diag(cos a, sin a, 0) V^T with two rotations and an angle has the seven parameters that it needs (Bartoli and
    Sturm 2004); they are found by the method of Levenberg and Marquardt.

    Args:
        F: float64 (3, 3), the start.
        left_px, right_px: float64 (N, 2), N >= 7.
        scale_px: see above; infinite for squares.

    Returns:
        float64 (3, 3), Frobenius norm 1.
    """
    to_left, to_right = common_scale(left_px, right_px)
    start = np.linalg.inv(to_right).T @ F @ np.linalg.inv(to_left)
    U, singular, Vt = np.linalg.svd(start)
    x_left, x_right = homogeneous(left_px) @ to_left.T, homogeneous(right_px) @ to_right.T
    problem = _Problem(x_left, x_right, np.identity(3), np.identity(3), scale_px * to_left[0, 0])
    refined = to_right.T @ _minimize(problem, U, Vt, float(np.arctan2(singular[1], singular[0])), True) @ to_left
    unit: F64 = refined / np.linalg.norm(refined)
    return unit


def refine_essential(E: F64, left_px: F64, right_px: F64, K_left: F64, K_right: F64, scale_px: float = np.inf) -> F64:
    """The essential matrix of least Sampson distance in pixels near E; as above with five parameters, a = 45 degrees.

    Args:
        E: float64 (3, 3), the start.
        left_px, right_px: float64 (N, 2), N >= 5, without distortion.
        K_left, K_right: float64 (3, 3), px.
        scale_px: see above; infinite for squares.

    Returns:
        float64 (3, 3), singular values 1, 1 and 0.
    """
    to_left, to_right = common_scale(left_px, right_px)
    before = np.asarray(np.linalg.inv(to_right @ K_right), np.float64).T
    after = np.asarray(np.linalg.inv(to_left @ K_left), np.float64)
    x_left, x_right = homogeneous(left_px) @ to_left.T, homogeneous(right_px) @ to_right.T
    problem = _Problem(x_left, x_right, before, after, scale_px * to_left[0, 0])
    U, _, Vt = np.linalg.svd(E)
    inner = _minimize(problem, U, Vt, np.pi / 4, False)
    essential: F64 = np.sqrt(2) * (to_right @ K_right).T @ inner @ to_left @ K_left
    return essential


def common_scale(left_px: F64, right_px: F64) -> tuple[F64, F64]:
    """float64 (3, 3) each: move both means to 0 and scale both images alike, so that distances in them compare."""
    means = left_px.mean(axis=0), right_px.mean(axis=0)
    squares = ((left_px - means[0]) ** 2).sum(axis=1) + ((right_px - means[1]) ** 2).sum(axis=1)
    scale = 2 / np.sqrt(squares.mean())
    left, right = (np.array([[scale, 0, -scale * x], [0, scale, -scale * y], [0, 0, 1]]) for x, y in means)
    return left, right


class _Problem:
    """Signed Sampson distances of matches, and their derivatives, for matrices ``before @ M @ after``."""

    def __init__(self, x_left: F64, x_right: F64, before: F64, after: F64, scale: float) -> None:
        self._x_left, self._x_right, self._before, self._after = x_left, x_right, before, after
        self.scale = scale

    def matrix(self, U: F64, Vt: F64, angle: float) -> F64:
        F: F64 = self._before @ (U * [np.cos(angle), np.sin(angle), 0]) @ Vt @ self._after
        return F

    def distances(self, F: F64) -> F64:
        """float64 (N,)."""
        error, slope, _ = self._parts(F)
        signed: F64 = error / slope
        return signed

    def jacobian(self, U: F64, Vt: F64, angle: float, free_angle: bool) -> F64:
        """float64 (N, 7): by the turns of U, by those of V, by the angle; (N, 5) where that is fixed at 45 degrees."""
        S = np.diag([np.cos(angle), np.sin(angle), 0])
        turns = np.concatenate([U @ _GENERATORS @ S @ Vt, -U @ S @ _GENERATORS @ Vt])
        by_angle = U @ np.diag([-np.sin(angle), np.cos(angle), 0]) @ Vt
        # With equal singular values U and V turned alike about the third axis change nothing
        changes = np.concatenate([turns, by_angle[None]]) if free_angle else np.delete(turns, 5, axis=0)
        return self._derivative(self.matrix(U, Vt, angle), self._before @ changes @ self._after)

    def _parts(self, F: F64) -> tuple[F64, F64, F64]:
        """x_right^T F x_left, the length of its gradient, and the gradient, float64 (N, 4)."""
        in_right, in_left = self._x_left @ F.T, self._x_right @ F
        gradient = np.hstack((in_right[:, :2], in_left[:, :2]))
        slope = np.maximum(np.linalg.norm(gradient, axis=1), np.finfo(np.float64).tiny)
        return np.einsum("ij,ij->i", self._x_right, in_right), slope, gradient

    def _derivative(self, F: F64, changes: F64) -> F64:
        error, slope, gradient = self._parts(F)
        in_right = np.einsum("kab,nb->nka", changes, self._x_left)
        in_left = np.einsum("kab,na->nkb", changes, self._x_right)
        d_error = np.einsum("nka,na->nk", in_right, self._x_right)
        d_gradient = np.concatenate((in_right[..., :2], in_left[..., :2]), axis=2)
        d_slope = np.einsum("nkc,nc->nk", d_gradient, gradient) / slope[:, None]
        derivative: F64 = (d_error - (error / slope)[:, None] * d_slope) / slope[:, None]
        return derivative


def _minimize(problem: _Problem, U: F64, Vt: F64, angle: float, free_angle: bool) -> F64:
    """Levenberg and Marquardt from U diag(cos a, sin a, 0) V^T; the matrix of the problem, float64 (3, 3)."""
    distances = problem.distances(problem.matrix(U, Vt, angle))
    cost, damping = robust_cost(distances, problem.scale), 1e-3
    for _ in range(_ITERATIONS):
        root_weights = 1 / (1 + (distances / problem.scale) ** 2)
        J = problem.jacobian(U, Vt, angle, free_angle) * root_weights[:, None]
        normal, slope = J.T @ J, J.T @ (root_weights * distances)
        step = np.linalg.lstsq(normal + damping * np.diag(normal.diagonal()), -slope, rcond=None)[0]
        trial = _moved(U, Vt, angle, np.asarray(step, np.float64))
        trial_distances = problem.distances(problem.matrix(*trial))
        decrease = cost - robust_cost(trial_distances, problem.scale)
        if decrease <= 0:
            if damping > 1e6:
                break
            damping *= 10
            continue
        (U, Vt, angle), distances = trial, trial_distances
        cost, damping = cost - decrease, damping / 10
        if decrease <= _SETTLED * cost:
            break
    return problem.matrix(U, Vt, angle)


def _moved(U: F64, Vt: F64, angle: float, step: F64) -> tuple[F64, F64, float]:
    """The two rotations turned, and the angle changed, by a step of 7 parameters, or of 5 that leave the angle."""
    step = step if len(step) == 7 else np.append(step, (0.0, 0.0))
    return U @ cv2.Rodrigues(step[:3])[0], cv2.Rodrigues(step[3:6])[0].T @ Vt, angle + float(step[6])

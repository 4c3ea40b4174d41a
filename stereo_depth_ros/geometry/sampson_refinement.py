# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Refinement of fundamental and essential matrices to least Sampson distances of matches.

The cost of distances d is the sum of squares, or, with a scale c, of d^2 / (1 + (d / c)^2) (Geman and McClure 1985),
which limits the influence of outliers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import homogeneous
from stereo_depth_ros.geometry.levenberg_marquardt import StopRules, damped_step, minimize
from stereo_depth_ros.geometry.relative_pose import cross_matrix
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = ["common_scale", "refine_essential", "refine_fundamental", "robust_cost", "robust_scale"]

_STOP = StopRules(max_trials=50, tolerance=1e-10, converged_steps=1, max_damping=3e7)
_GENERATORS = np.stack([cross_matrix(axis) for axis in np.identity(3)])


def robust_scale(distances: F64) -> float:
    """A scale c for distances, float64 (N,), with outliers: 2.5 standard deviations, estimated from the median.

    Above 0 for matches without noise too.
    """
    return max(2.5 * robust_sigma(distances), 1e-6)


def robust_cost(distances: F64, scale: float) -> float:
    """The cost that the refinements minimize, of distances float64 (N,)."""
    squared = distances**2
    return float(np.sum(squared / (1 + squared / scale**2)))


def refine_fundamental(F: F64, left_px: F64, right_px: F64, scale_px: float = np.inf) -> F64:
    """The fundamental matrix of least Sampson distance near F, of rank 2 at every step.

    F = U diag(cos a, sin a, 0) V^T has the minimal seven parameters in two rotations and an angle (Bartoli and Sturm
    2004), which are optimized by Levenberg-Marquardt.

    Args:
        F: float64 (3, 3), the initial value.
        left_px, right_px: float64 (N, 2), N >= 7.
        scale_px: scale c of the cost; infinite for squares.

    Returns:
        float64 (3, 3), Frobenius norm 1.
    """
    to_left, to_right = common_scale(left_px, right_px)
    U, singular, Vt = np.linalg.svd(np.linalg.inv(to_right).T @ F @ np.linalg.inv(to_left))
    x_left, x_right = homogeneous(left_px) @ to_left.T, homogeneous(right_px) @ to_right.T
    problem = _Problem(x_left, x_right, np.identity(3), np.identity(3), scale_px * to_left[0, 0])
    start = _Factors(problem, U, Vt, float(np.arctan2(singular[1], singular[0])), free_angle=True)
    refined = to_right.T @ minimize(start, _STOP).matrix @ to_left
    unit: F64 = refined / np.linalg.norm(refined)
    return unit


def refine_essential(E: F64, left_px: F64, right_px: F64, K_left: F64, K_right: F64, scale_px: float = np.inf) -> F64:
    """The essential matrix of least Sampson distance in pixels near E; as above with five parameters, a = 45 degrees.

    Args:
        E: float64 (3, 3), the initial value.
        left_px, right_px: float64 (N, 2), N >= 5, without distortion.
        K_left, K_right: float64 (3, 3), px.
        scale_px: scale c of the cost; infinite for squares.

    Returns:
        float64 (3, 3), singular values 1, 1 and 0.
    """
    to_left, to_right = common_scale(left_px, right_px)
    before = np.asarray(np.linalg.inv(to_right @ K_right), np.float64).T
    after = np.asarray(np.linalg.inv(to_left @ K_left), np.float64)
    x_left, x_right = homogeneous(left_px) @ to_left.T, homogeneous(right_px) @ to_right.T
    problem = _Problem(x_left, x_right, before, after, scale_px * to_left[0, 0])
    U, _, Vt = np.linalg.svd(E)
    refined = minimize(_Factors(problem, U, Vt, np.pi / 4, free_angle=False), _STOP).matrix
    essential: F64 = np.sqrt(2) * (to_right @ K_right).T @ refined @ to_left @ K_left
    return essential


def common_scale(left_px: F64, right_px: F64) -> tuple[F64, F64]:
    """float64 (3, 3) each: move both means to 0 and scale both images equally, so that distances are comparable."""
    means = left_px.mean(axis=0), right_px.mean(axis=0)
    squares = ((left_px - means[0]) ** 2).sum(axis=1) + ((right_px - means[1]) ** 2).sum(axis=1)
    scale = 2 / np.sqrt(squares.mean())
    left, right = (np.array([[scale, 0, -scale * x], [0, scale, -scale * y], [0, 0, 1]]) for x, y in means)
    return left, right


@dataclass(frozen=True, eq=False)
class _Problem:
    """Matches, float64 (N, 3) each, and the factors of matrices ``before @ M @ after`` that are fitted to them."""

    x_left: F64
    x_right: F64
    before: F64
    after: F64
    scale: float

    def sampson(self, F: F64) -> tuple[F64, F64, F64]:
        """x_right^T F x_left, float64 (N,), the length of its gradient, and the gradient, float64 (N, 4)."""
        in_right, in_left = self.x_left @ F.T, self.x_right @ F
        gradient = np.hstack((in_right[:, :2], in_left[:, :2]))
        slope = np.maximum(np.linalg.norm(gradient, axis=1), np.finfo(np.float64).tiny)
        return np.einsum("ij,ij->i", self.x_right, in_right), slope, gradient

    def jacobian(self, F: F64, changes: F64) -> F64:
        """Derivatives of the signed distances, float64 (N, P), by P changes of F, float64 (P, 3, 3)."""
        error, slope, gradient = self.sampson(F)
        in_right = np.einsum("kab,nb->nka", changes, self.x_left)
        in_left = np.einsum("kab,na->nkb", changes, self.x_right)
        d_error = np.einsum("nka,na->nk", in_right, self.x_right)
        d_gradient = np.concatenate((in_right[..., :2], in_left[..., :2]), axis=2)
        d_slope = np.einsum("nkc,nc->nk", d_gradient, gradient) / slope[:, None]
        derivative: F64 = (d_error - (error / slope)[:, None] * d_slope) / slope[:, None]
        return derivative


@dataclass(frozen=True, eq=False)
class _Factors:
    """An iterate M = U diag(cos a, sin a, 0) V^T; a is constant unless ``free_angle``."""

    problem: _Problem
    U: F64
    Vt: F64
    angle: float
    free_angle: bool

    @cached_property
    def matrix(self) -> F64:
        """float64 (3, 3), ``before @ M @ after``."""
        M = (self.U * [np.cos(self.angle), np.sin(self.angle), 0]) @ self.Vt
        F: F64 = self.problem.before @ M @ self.problem.after
        return F

    @cached_property
    def cost(self) -> float:
        return robust_cost(self._distances, self.problem.scale)

    def trial(self, damping: float) -> _Factors:
        """Both rotations and the angle after a damped step."""
        step = damped_step(*self._normal_equations, damping)
        step = step if self.free_angle else np.append(step, (0.0, 0.0))
        U, Vt = self.U @ cv2.Rodrigues(step[:3])[0], cv2.Rodrigues(step[3:6])[0].T @ self.Vt
        return replace(self, U=U, Vt=Vt, angle=self.angle + float(step[6]))

    @cached_property
    def _distances(self) -> F64:
        """float64 (N,), signed."""
        error, slope, _ = self.problem.sampson(self.matrix)
        signed: F64 = error / slope
        return signed

    @cached_property
    def _normal_equations(self) -> tuple[F64, F64]:
        """J^T J and J^T r of the reweighted distances."""
        root_weights = 1 / (1 + (self._distances / self.problem.scale) ** 2)
        J = self.problem.jacobian(self.matrix, self._changes()) * root_weights[:, None]
        return J.T @ J, J.T @ (root_weights * self._distances)

    def _changes(self) -> F64:
        """Derivatives of the matrix by the rotations of U and V and the angle, float64 (7, 3, 3), or (5, 3, 3)."""
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        S = np.diag([cosine, sine, 0])
        rotations = np.concatenate([self.U @ _GENERATORS @ S @ self.Vt, -self.U @ S @ _GENERATORS @ self.Vt])
        by_angle = self.U @ np.diag([-sine, cosine, 0]) @ self.Vt
        # With equal singular values U and V rotated alike about the third axis change nothing
        changes = np.concatenate([rotations, by_angle[None]]) if self.free_angle else np.delete(rotations, 5, axis=0)
        derivatives: F64 = self.problem.before @ changes @ self.problem.after
        return derivatives

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Normal equations of a bundle adjustment: parameters that all views share, and one pose for each view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64

__all__ = ["NormalEquations"]

POSE = 6
_ROUNDING = 1e-13  # smallest eigenvalue used, as a fraction of the largest


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Contributions of V views to J^T J and J^T r, over S shared parameters and the 6 parameters of each pose.

    Poses are eliminated view by view (Schur complement), so that the cost is linear in V.

    Attributes:
        normal: float64 (V, S + 6, S + 6).
        gradient: float64 (V, S + 6).
        cost: sum of squares.
    """

    normal: F64
    gradient: F64
    cost: float

    @property
    def shared(self) -> int:
        """Number of shared parameters."""
        return int(self.gradient.shape[1]) - POSE

    def step(self, damping: float) -> tuple[F64, F64]:
        """Levenberg-Marquardt step of the shared parameters, float64 (S,), and of the poses, float64 (V, 6).

        Args:
            damping: 0 or above, as a share of the diagonal of J^T J.
        """
        S = self.shared
        damped = self.normal.copy()
        poses = np.arange(S, S + POSE)
        damped[:, poses, poses] *= 1 + damping
        reduced, gradient, to_pose, pose_offset = _schur_complement(damped, self.gradient)
        total = reduced.sum(axis=0)
        total[np.diag_indices(S)] += damping * np.einsum("vii->i", self.normal)[:S]
        shared = -_scaled_solve(total, gradient.sum(axis=0))
        return shared, -pose_offset - to_pose @ shared

    def covariance(self) -> F64:
        """Covariance of the shared parameters for residuals of variance 1, float64 (S, S).

        Raises:
            CalibrationError: the views do not determine the parameters.
        """
        total = _schur_complement(self.normal, self.gradient)[0].sum(axis=0)
        return _inverse(total)

    def jackknife(self) -> F64:
        """Jackknife covariance of the shared parameters at the minimum, float64 (S, S), over views.

        Each view is removed in turn, to first order (Efron 1982, The jackknife, the bootstrap and other resampling
        plans).

        Raises:
            CalibrationError: the views do not determine the parameters without one of them.
        """
        reduced, gradient, _, _ = _schur_complement(self.normal, self.gradient)
        total, views = reduced.sum(axis=0), len(reduced)
        changes = np.array([_inverse(total - each) @ g for each, g in zip(reduced, gradient, strict=True)])
        centered = changes - changes.mean(axis=0)
        covariance: F64 = (views - 1) / views * centered.T @ centered
        return covariance


def _schur_complement(normal: F64, gradient: F64) -> tuple[F64, F64, F64, F64]:
    """Reduced matrix and gradient of each view; matrix and offset of the back substitution for its pose."""
    S = gradient.shape[1] - POSE
    mixed = normal[:, S:, :S]
    right = np.concatenate([mixed, gradient[:, S:, None]], axis=2)
    try:
        solved = np.linalg.solve(normal[:, S:, S:], right)
    except np.linalg.LinAlgError:
        solved = np.full_like(right, np.nan)
    to_pose, pose_offset = solved[:, :, :S], solved[:, :, S]
    across = mixed.transpose(0, 2, 1)
    reduced = normal[:, :S, :S] - across @ to_pose
    return reduced, gradient[:, :S] - (across @ pose_offset[:, :, None])[:, :, 0], to_pose, pose_offset


def _scaled_solve(matrix: F64, right: F64) -> F64:
    """Solve with parameters scaled to a unit diagonal, as their units differ widely; NaN where singular."""
    scale = _scale(matrix)
    try:
        return np.asarray(np.linalg.solve(matrix / np.outer(scale, scale), right / scale) / scale, np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)


def _scale(matrix: F64) -> F64:
    scale: F64 = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return scale


def _inverse(matrix: F64) -> F64:
    """Inverse of a symmetric matrix; directions that are singular up to rounding become large, not infinite.

    Coefficients of a distortion model with many of them can compensate each other; the other parameters are still
    determined.
    """
    if not matrix.size:  # every parameter is held
        return matrix
    scale = _scale(matrix)
    try:
        values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        values, vectors = np.zeros(1), np.zeros((1, 1))
    if not values[-1] > 0:
        raise CalibrationError(
            "the views do not determine the cameras",
            remedy="tilt the board about both axes, move it to all parts of the image, or use a distortion model with "
            "fewer coefficients",
            settings=("model",),
        )
    inverse: F64 = (vectors / np.maximum(values, _ROUNDING * values[-1])) @ vectors.T / np.outer(scale, scale)
    return inverse

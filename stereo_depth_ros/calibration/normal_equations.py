# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Normal equations of a least-squares problem in which each view has a pose of its own beside what all views share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64

__all__ = ["NormalEquations"]

POSE = 6
_ROUNDING = 1e-13  # of the largest eigenvalue


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """What each of V views adds to J^T J and J^T r, over the S shared parameters and the 6 of its pose.

    Poses are eliminated view by view (Schur complement), so that the work grows with V only.

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
        """Gauss and Newton's step of the shared parameters (S,) and of the poses (V, 6), damped as Marquardt does.

        Args:
            damping: 0 or above, as a share of the diagonal.
        """
        S = self.shared
        damped = self.normal.copy()
        poses = np.arange(S, S + POSE)
        damped[:, poses, poses] *= 1 + damping
        reduced, gradient, to_pose, own_step = _eliminated(damped, self.gradient)
        total = reduced.sum(axis=0)
        total[np.diag_indices(S)] += damping * np.einsum("vii->i", self.normal)[:S]
        shared = -_scaled_solve(total, gradient.sum(axis=0))
        return shared, -own_step - to_pose @ shared

    def covariance(self) -> F64:
        """Inverse of the normal matrix, its part of the shared parameters, (S, S); times sigma squared of a residual.

        Raises:
            CalibrationError: the views do not determine the parameters.
        """
        total = _eliminated(self.normal, self.gradient)[0].sum(axis=0)
        return _inverse(total)

    def jackknife(self) -> F64:
        """Covariance of the shared parameters at the minimum, (S, S), by how they move when one view is left out.

        To first order in that move (Efron 1982, The jackknife, the bootstrap and other resampling plans).

        Raises:
            CalibrationError: the views do not determine the parameters when one of them is left out.
        """
        reduced, gradient, _, _ = _eliminated(self.normal, self.gradient)
        total, views = reduced.sum(axis=0), len(reduced)
        moves = np.array([_inverse(total - own) @ g for own, g in zip(reduced, gradient, strict=True)])
        centred = moves - moves.mean(axis=0)
        covariance: F64 = (views - 1) / views * centred.T @ centred
        return covariance


def _eliminated(normal: F64, gradient: F64) -> tuple[F64, F64, F64, F64]:
    """Matrix and gradient of the shared parameters of each view, and what gives its pose's step from theirs."""
    S = gradient.shape[1] - POSE
    mixed = normal[:, S:, :S]
    right = np.concatenate([mixed, gradient[:, S:, None]], axis=2)
    try:
        solved = np.linalg.solve(normal[:, S:, S:], right)
    except np.linalg.LinAlgError:
        solved = np.full_like(right, np.nan)
    to_pose, own_step = solved[:, :, :S], solved[:, :, S]
    across = mixed.transpose(0, 2, 1)
    reduced = normal[:, :S, :S] - across @ to_pose
    return reduced, gradient[:, :S] - (across @ own_step[:, :, None])[:, :, 0], to_pose, own_step


def _scaled_solve(matrix: F64, right: F64) -> F64:
    """Solves with all parameters scaled alike: pixels and sixth powers of angles are far apart. NaN where singular."""
    scale = _scale(matrix)
    try:
        return np.asarray(np.linalg.solve(matrix / np.outer(scale, scale), right / scale) / scale, np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)


def _scale(matrix: F64) -> F64:
    scale: F64 = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return scale


def _inverse(matrix: F64) -> F64:
    """Of a symmetric matrix; what it leaves open, up to rounding, comes out large and not infinite.

    Coefficients of a rich lens model can be exchanged for each other without a trace in the image: the others are
    known all the same.
    """
    scale = _scale(matrix)
    try:
        values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        values, vectors = np.zeros(1), np.zeros((1, 1))
    if not values[-1] > 0:
        raise CalibrationError(
            "the views do not determine the cameras: tilt the board about both axes and take it to all parts of the "
            "image, or take a distortion model with fewer coefficients"
        )
    inverse: F64 = (vectors / np.maximum(values, _ROUNDING * values[-1])) @ vectors.T / np.outer(scale, scale)
    return inverse

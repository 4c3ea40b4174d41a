# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which distortion coefficients of a projector the poses determine: those that predict poses that were left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.calibration.projection import Projection, parameter_names, project
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.levenberg_marquardt import StopRules, damped_step, minimize

__all__ = ["determined_coefficients"]

# From none to all; a projector shows no more of k3 and above, as its field of view is narrow
_COEFFICIENTS: tuple[tuple[str, ...], ...] = ((), ("k1",), ("k1", "k2"), ("k1", "k2", "p1", "p2"))
_MOST_FOLDS = 6
_GAIN, _LEAST_PX = 0.02, 1e-3  # relative decrease of the error of the prediction that further coefficients have to give
_STOP = StopRules(max_trials=60, tolerance=1e-9, converged_steps=2, max_damping=1e12)


def determined_coefficients(
    model: str, intrinsics: F64, rig: F64, points_m: Sequence[F64], image_px: Sequence[F64]
) -> tuple[str, ...]:
    """The coefficients that predict corners that were left out of the fit best.

    Poses are left out in turn, in six groups at most; of two poses every sixth corner (cross-validation, Stone 1974).
    Further coefficients have to reduce the error of the prediction by 2 %.

    Args:
        model: distortion model.
        intrinsics: float64 (4 + n,), a first projector: fx, fy, cx, cy, coefficients.
        rig: float64 (6,), its rotation vector and translation, meters, from the camera.
        points_m: float64 (N, 3) for each pose, corners in the frame of the camera.
        image_px: float64 (N, 2) for each pose, corners in the projector.

    Returns:
        their names, of none, k1, k1 and k2, or these and p1 and p2.
    """
    points, pixels = np.concatenate(points_m), np.concatenate(image_px)
    folds, values = _folds(points_m), np.concatenate((intrinsics, rig))
    best, determined = np.inf, _COEFFICIENTS[0]
    for names in _COEFFICIENTS:
        error = _prediction_px(_Fit(model, _free(model, names), points, pixels, values), folds)
        if error < (1 - _GAIN) * best and best > _LEAST_PX:
            best, determined = error, names
    return determined


def _folds(points_m: Sequence[F64]) -> npt.NDArray[np.int64]:
    """Number of the group that each corner is left out with."""
    if len(points_m) > 2:
        return np.concatenate([np.full(len(each), pose % _MOST_FOLDS) for pose, each in enumerate(points_m)])
    return np.concatenate([np.arange(len(each)) % _MOST_FOLDS for each in points_m])


def _free(model: str, names: Sequence[str]) -> npt.NDArray[np.int64]:
    """Indices of the free parameters: focal lengths, principal point, these coefficients, pose."""
    known = parameter_names(model)
    return np.array([*range(4), *(known.index(name) for name in names), *range(len(known), len(known) + 6)])


def _prediction_px(start: _Fit, folds: npt.NDArray[np.int64]) -> float:
    """Root mean square error of the corners that were left out, px."""
    squares = []
    for fold in np.unique(folds):
        used = folds != fold
        fitted = minimize(replace(start, points=start.points[used], pixels=start.pixels[used]), _STOP)
        left_out = replace(start, points=start.points[~used], pixels=start.pixels[~used], values=fitted.values)
        squares.append(np.square(left_out.residuals).sum(axis=1))
    return float(np.sqrt(np.concatenate(squares).mean()))


@dataclass(frozen=True, eq=False)
class _Fit:
    """A projector, intrinsics then pose, fitted to points in the frame of the camera."""

    model: str
    free: npt.NDArray[np.int64]
    points: F64
    pixels: F64
    values: F64

    @cached_property
    def projection(self) -> Projection:
        return project(self.model, self.values[:-6], self.values[-6:], self.points)

    @property
    def residuals(self) -> F64:
        return self.projection.image_px - self.pixels

    @property
    def cost(self) -> float:
        return float(np.square(self.residuals).sum())

    def trial(self, damping: float) -> _Fit:
        J = np.hstack((self.projection.jacobian_intrinsics, self.projection.jacobian_pose))[:, self.free]
        values = self.values.copy()
        values[self.free] += damped_step(J.T @ J, J.T @ self.residuals.ravel(), damping)
        return replace(self, values=values)

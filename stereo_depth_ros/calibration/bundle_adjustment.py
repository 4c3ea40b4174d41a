# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares over all views of a board: cameras, rig and poses together, with their covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.normal_equations import NormalEquations
from stereo_depth_ros.calibration.projection import Projection, project
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.levenberg_marquardt import StopRules, minimize

__all__ = ["BundleAdjustment", "Estimate", "adjust_bundle", "residuals_px"]

# A relative decrease of 1e-9 of the sum of squares is far below one standard deviation
_STOP = StopRules(max_trials=100, tolerance=1e-9, converged_steps=2, max_damping=1e12)
_ROUNDS = 5  # of weights
_TAIL = 3.0  # standard deviations at which a corner's weight is a half


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is solved for.

    Attributes:
        model: distortion model of the cameras.
        intrinsics: one float64 (4 + n,) a camera: fx, fy, cx, cy, coefficients.
        rig: float64 (6,), rotation vector and translation, meters, from the first camera to the second; zeros for one.
        poses: float64 (V, 6), rotation vector and translation from the board to the first camera, a view each.
        fixed: numbers of intrinsic parameters that are not solved for but stay what they are, in every camera.
    """

    model: str
    intrinsics: tuple[F64, ...]
    rig: F64
    poses: F64
    fixed: tuple[int, ...] = ()

    @property
    def shared(self) -> int:
        """Number of parameters that all views share."""
        return sum(each.size for each in self.intrinsics) + 6 * (len(self.intrinsics) - 1)

    @property
    def free(self) -> npt.NDArray[np.int64]:
        """Numbers of the shared parameters that are solved for, (F,)."""
        fixed = [side * each.size + number for side, each in enumerate(self.intrinsics) for number in self.fixed]
        return np.setdiff1d(np.arange(self.shared), fixed)

    def moved(self, step: F64, pose_steps: F64) -> Estimate:
        """With ``step`` (F,) added to the free shared parameters, ``pose_steps`` (V, 6) to the poses."""
        steps = np.zeros(self.shared)
        steps[self.free] = step
        at, intrinsics = 0, []
        for each in self.intrinsics:
            intrinsics.append(each + steps[at : at + each.size])
            at += each.size
        rig = self.rig + steps[at:] if steps.size > at else self.rig
        return replace(self, intrinsics=tuple(intrinsics), rig=rig, poses=self.poses + pose_steps)


@dataclass(frozen=True, eq=False)
class BundleAdjustment:
    """The solution.

    Attributes:
        estimate: at the minimum.
        residuals: px, projected less seen: a tuple of float64 (N, 2), one a camera, for each view.
        covariance: float64 (S, S) of the shared parameters, intrinsics then rig, from Jacobian and residuals, for
            corners whose errors do not depend on each other; 0 for fixed ones.
        view_covariance: the same from how the views disagree (jackknife): what all corners of a view have in common, as
            blur or a board that is not flat, is in it.
    """

    estimate: Estimate
    residuals: list[tuple[F64, ...]]
    covariance: F64
    view_covariance: F64

    def view_rms_px(self, side: int) -> F64:
        """Root mean square distance of the corners of each view, float64 (V,), px."""
        return np.array([np.sqrt(np.square(view[side]).sum(axis=1).mean()) for view in self.residuals])

    def sigma(self, direction: F64) -> float:
        """Standard deviation of ``direction`` (S,) times the shared parameters, the larger of the two estimates."""
        return max(float(np.sqrt(direction @ each @ direction)) for each in (self.covariance, self.view_covariance))

    @property
    def sigmas(self) -> F64:
        """Standard deviations of the shared parameters, float64 (S,)."""
        return np.array([self.sigma(direction) for direction in np.identity(self.estimate.shared)])

    def rms_px(self, side: int | None = None) -> float:
        """Root mean square distance of all corners of one camera, or of all, px."""
        sides = range(len(self.estimate.intrinsics)) if side is None else (side,)
        squares = [np.square(view[each]).sum(axis=1) for view in self.residuals for each in sides]
        return float(np.sqrt(np.concatenate(squares).mean()))


def adjust_bundle(views: Sequence[tuple[Corners, ...]], start: Estimate, robust: bool = False) -> BundleAdjustment:
    """The estimate with the least squares of reprojection errors, after Levenberg and Marquardt.

    Args:
        views: the corners of each view, one :class:`Corners` a camera.
        start: where to begin.
        robust: weigh corners with large errors down (Cauchy's weights), so that wrong views show themselves.

    Raises:
        CalibrationError: the views do not determine the parameters.
    """
    weights = [tuple(np.ones(len(corners.ids)) for corners in view) for view in views]
    solution = minimize(_Iterate(views, weights, start), _STOP)
    for _ in range(_ROUNDS if robust else 0):
        weights = _cauchy_weights(residuals_px(views, solution.estimate))
        solution = minimize(_Iterate(views, weights, solution.estimate), _STOP)
    estimate, equations = solution.estimate, solution.equations
    residuals = residuals_px(views, estimate)
    freedom = sum(each.size for view in residuals for each in view) - len(estimate.free) - 6 * len(views)
    if freedom <= 0:
        raise CalibrationError(
            f"{len(views)} views measure too little for {len(estimate.free)} parameters: take more views of the board"
        )
    covariance = equations.cost / freedom * equations.covariance()
    return BundleAdjustment(
        estimate, residuals, _of_all(covariance, estimate), _of_all(equations.jackknife(), estimate)
    )


def _of_all(covariance: F64, estimate: Estimate) -> F64:
    """Covariance (S, S) of all shared parameters from that of the free ones."""
    whole = np.zeros((estimate.shared, estimate.shared))
    whole[np.ix_(estimate.free, estimate.free)] = covariance
    return whole


def residuals_px(views: Sequence[tuple[Corners, ...]], estimate: Estimate) -> list[tuple[F64, ...]]:
    """Projected less seen, px: for each view a float64 (N, 2) a camera."""
    return [
        tuple(
            _project(estimate, side, pose, corners)[0].image_px - corners.image_px for side, corners in enumerate(view)
        )
        for view, pose in zip(views, estimate.poses, strict=True)
    ]


def _project(estimate: Estimate, side: int, pose: F64, corners: Corners) -> tuple[Projection, F64, F64]:
    """The projection in one camera, and the derivatives (6, 6) of its pose by the rig and by the first camera's."""
    if side == 0:
        return project(estimate.model, estimate.intrinsics[0], pose, corners.board_m), np.zeros((6, 6)), np.identity(6)
    rig = estimate.rig
    rotation, translation, *D = cv2.composeRT(pose[:3], pose[3:], rig[:3], rig[3:])
    by_pose = np.block([[D[0], D[1]], [D[4], D[5]]])
    by_rig = np.block([[D[2], D[3]], [D[6], D[7]]])
    second = np.concatenate([rotation.ravel(), translation.ravel()])
    return project(estimate.model, estimate.intrinsics[side], second, corners.board_m), by_rig, by_pose


@dataclass(frozen=True, eq=False)
class _Iterate:
    """An estimate with its normal equations."""

    views: Sequence[tuple[Corners, ...]]
    weights: list[tuple[F64, ...]]
    estimate: Estimate

    @cached_property
    def equations(self) -> NormalEquations:
        return _equations(self.views, self.estimate, self.weights)

    @property
    def cost(self) -> float:
        return self.equations.cost

    def trial(self, damping: float) -> _Iterate:
        return replace(self, estimate=self.estimate.moved(*self.equations.step(damping)))


def _equations(
    views: Sequence[tuple[Corners, ...]], estimate: Estimate, weights: list[tuple[F64, ...]]
) -> NormalEquations:
    shared, size = estimate.shared, estimate.intrinsics[0].size
    columns = np.concatenate([estimate.free, shared + np.arange(6)])
    normal = np.zeros((len(views), columns.size, columns.size))
    gradient, cost = np.zeros((len(views), columns.size)), 0.0
    for number, view in enumerate(views):
        for side, corners in enumerate(view):
            projection, by_rig, by_pose = _project(estimate, side, estimate.poses[number], corners)
            J = np.zeros((2 * len(corners.ids), shared + 6))
            J[:, side * size : (side + 1) * size] = projection.by_intrinsics
            if side:
                J[:, shared - 6 : shared] = projection.by_pose @ by_rig
            J[:, shared:] = projection.by_pose @ by_pose
            J = J[:, columns]
            residuals = (projection.image_px - corners.image_px).ravel()
            w = np.repeat(weights[number][side], 2)
            normal[number] += J.T @ (w[:, None] * J)
            gradient[number] += J.T @ (w * residuals)
            cost += float(w @ np.square(residuals))
    return NormalEquations(normal, gradient, cost)


def _cauchy_weights(residuals: list[tuple[F64, ...]]) -> list[tuple[F64, ...]]:
    distances = [tuple(np.linalg.norm(each, axis=1) for each in view) for view in residuals]
    median = np.median(np.concatenate([each for view in distances for each in view]))
    limit = max(_TAIL * float(median) / 1.1774, 1e-9)  # the median of a Rayleigh distribution is 1.1774 sigma
    return [tuple(1 / (1 + np.square(each / limit)) for each in view) for view in distances]

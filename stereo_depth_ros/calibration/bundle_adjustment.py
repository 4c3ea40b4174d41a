# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment over all views of a board: intrinsics, relative pose and board poses, with their covariance."""

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

__all__ = ["BundleParameters", "BundleSolution", "adjust_bundle", "residuals_px"]

# A relative decrease of 1e-9 of the sum of squares is far below one standard deviation
_STOP = StopRules(max_trials=100, tolerance=1e-9, converged_steps=2, max_damping=1e12)
_ROUNDS = 5  # number of times the robust weights are computed
_CAUCHY_SIGMAS = 3.0  # residual, in standard deviations, at which the weight of a corner is a half


@dataclass(frozen=True, eq=False)
class BundleParameters:
    """Parameters of one or two cameras and V views.

    Attributes:
        model: distortion model of the cameras.
        intrinsics: float64 (4 + n,) for each camera: fx, fy, cx, cy, coefficients.
        rig: float64 (6,), rotation vector and translation, meters, from the first camera to the second; zeros for one
            camera.
        poses: float64 (V, 6), rotation vector and translation, meters, from the board to the first camera.
        fixed: indices of intrinsic parameters that are held constant in every camera.
        held: indices of shared parameters that are held constant, such as the intrinsics of a camera that is known.
    """

    model: str
    intrinsics: tuple[F64, ...]
    rig: F64
    poses: F64
    fixed: tuple[int, ...] = ()
    held: tuple[int, ...] = ()

    @property
    def shared_count(self) -> int:
        """Number S of parameters that all views share."""
        return sum(each.size for each in self.intrinsics) + 6 * (len(self.intrinsics) - 1)

    @property
    def free_indices(self) -> npt.NDArray[np.int64]:
        """Indices of the shared parameters that are solved for, (F,)."""
        fixed = [side * each.size + number for side, each in enumerate(self.intrinsics) for number in self.fixed]
        return np.setdiff1d(np.arange(self.shared_count), [*fixed, *self.held])

    def updated(self, step: F64, pose_steps: F64) -> BundleParameters:
        """With ``step`` (F,) added to the free shared parameters, ``pose_steps`` (V, 6) to the poses."""
        steps = np.zeros(self.shared_count)
        steps[self.free_indices] = step
        at, intrinsics = 0, []
        for each in self.intrinsics:
            intrinsics.append(each + steps[at : at + each.size])
            at += each.size
        rig = self.rig + steps[at:] if steps.size > at else self.rig
        return replace(self, intrinsics=tuple(intrinsics), rig=rig, poses=self.poses + pose_steps)


@dataclass(frozen=True, eq=False)
class BundleSolution:
    """Parameters of least reprojection error.

    Attributes:
        parameters: at the minimum.
        residuals: px, projected minus detected corners: for each view a tuple of float64 (N, 2), one for each camera.
        covariance: float64 (S, S) of the shared parameters, intrinsics then rig, from Jacobian and residuals, for
            independent corner errors; 0 for fixed parameters.
        view_covariance: float64 (S, S), the jackknife estimate over views; it includes errors that all corners of a
            view have in common, such as blur or a board that is not flat.
    """

    parameters: BundleParameters
    residuals: list[tuple[F64, ...]]
    covariance: F64
    view_covariance: F64

    def view_rms_px(self, side: int) -> F64:
        """Reprojection rms of each view in one camera, float64 (V,), px."""
        return np.array([np.sqrt(np.square(view[side]).sum(axis=1).mean()) for view in self.residuals])

    def sigma(self, direction: F64) -> float:
        """Standard deviation of ``direction`` (S,) times the shared parameters, the larger of the two estimates."""
        return max(float(np.sqrt(direction @ each @ direction)) for each in (self.covariance, self.view_covariance))

    @property
    def sigmas(self) -> F64:
        """Standard deviations of the shared parameters, float64 (S,)."""
        return np.array([self.sigma(direction) for direction in np.identity(self.parameters.shared_count)])

    def rms_px(self, side: int | None = None) -> float:
        """Reprojection rms of all corners of one camera, or of all cameras, px."""
        sides = range(len(self.parameters.intrinsics)) if side is None else (side,)
        squares = [np.square(view[each]).sum(axis=1) for view in self.residuals for each in sides]
        return float(np.sqrt(np.concatenate(squares).mean()))


def adjust_bundle(
    views: Sequence[tuple[Corners, ...]], start: BundleParameters, robust: bool = False
) -> BundleSolution:
    """Minimize the sum of squared reprojection errors by Levenberg-Marquardt.

    Args:
        views: the corners of each view, one :class:`Corners` for each camera.
        start: initial parameters.
        robust: use Cauchy weights, so that outlier views do not distort the others.

    Raises:
        CalibrationError: the views do not determine the parameters.
    """
    weights = [tuple(np.ones(len(corners.ids)) for corners in view) for view in views]
    solution = minimize(_Iterate(views, weights, start), _STOP)
    for _ in range(_ROUNDS if robust else 0):
        weights = _cauchy_weights(residuals_px(views, solution.parameters))
        solution = minimize(_Iterate(views, weights, solution.parameters), _STOP)
    parameters, equations = solution.parameters, solution.equations
    residuals = residuals_px(views, parameters)
    freedom = sum(each.size for view in residuals for each in view) - len(parameters.free_indices) - 6 * len(views)
    if freedom <= 0:
        raise CalibrationError(
            f"{len(views)} views give no more measurements than the {len(parameters.free_indices)} camera parameters "
            "and the board poses have",
            value=len(views),
            remedy="use more views of the board",
        )
    covariance = equations.cost / freedom * equations.covariance()
    return BundleSolution(
        parameters,
        residuals,
        _with_fixed(covariance, parameters),
        _with_fixed(equations.jackknife(), parameters),
    )


def _with_fixed(covariance: F64, parameters: BundleParameters) -> F64:
    """Covariance of all shared parameters, float64 (S, S), from that of the free ones."""
    whole = np.zeros((parameters.shared_count, parameters.shared_count))
    whole[np.ix_(parameters.free_indices, parameters.free_indices)] = covariance
    return whole


def residuals_px(views: Sequence[tuple[Corners, ...]], parameters: BundleParameters) -> list[tuple[F64, ...]]:
    """Projected minus detected corners, px: for each view a tuple of float64 (N, 2), one for each camera."""
    return [
        tuple(
            _project(parameters, side, pose, corners)[0].image_px - corners.image_px
            for side, corners in enumerate(view)
        )
        for view, pose in zip(views, parameters.poses, strict=True)
    ]


def _project(
    parameters: BundleParameters, side: int, pose: F64, corners: Corners
) -> tuple[Projection, tuple[F64, F64] | None]:
    """The projection in one camera; Jacobians (6, 6) of the second one's board pose by the rig and by the first's."""
    model, intrinsics, rig = parameters.model, parameters.intrinsics[side], parameters.rig
    if side == 0:
        return project(model, intrinsics, pose, corners.board_m), None
    rotation, translation, *D = cv2.composeRT(pose[:3], pose[3:], rig[:3], rig[3:])
    by_pose, by_rig = np.empty((2, 6, 6))
    for jacobian, parts in ((by_pose, (D[0], D[1], D[4], D[5])), (by_rig, (D[2], D[3], D[6], D[7]))):
        jacobian[:3, :3], jacobian[:3, 3:], jacobian[3:, :3], jacobian[3:, 3:] = parts
    second = np.concatenate([rotation.ravel(), translation.ravel()])
    return project(model, intrinsics, second, corners.board_m), (by_rig, by_pose)


@dataclass(frozen=True, eq=False)
class _Iterate:
    """Parameters with their normal equations."""

    views: Sequence[tuple[Corners, ...]]
    weights: list[tuple[F64, ...]]
    parameters: BundleParameters

    @cached_property
    def equations(self) -> NormalEquations:
        return _equations(self.views, self.parameters, self.weights)

    @property
    def cost(self) -> float:
        return self.equations.cost

    def trial(self, damping: float) -> _Iterate:
        return replace(self, parameters=self.parameters.updated(*self.equations.step(damping)))


def _equations(
    views: Sequence[tuple[Corners, ...]], parameters: BundleParameters, weights: list[tuple[F64, ...]]
) -> NormalEquations:
    shared, size = parameters.shared_count, parameters.intrinsics[0].size
    columns = np.concatenate([parameters.free_indices, shared + np.arange(6)])
    normal = np.zeros((len(views), columns.size, columns.size))
    gradient, cost = np.zeros((len(views), columns.size)), 0.0
    for number, view in enumerate(views):
        for side, corners in enumerate(view):
            projection, second = _project(parameters, side, parameters.poses[number], corners)
            J = np.zeros((2 * len(corners.ids), shared + 6))
            J[:, side * size : (side + 1) * size] = projection.jacobian_intrinsics
            if second is None:
                J[:, shared:] = projection.jacobian_pose
            else:
                by_rig, by_pose = second
                J[:, shared - 6 : shared] = projection.jacobian_pose @ by_rig
                J[:, shared:] = projection.jacobian_pose @ by_pose
            J = J[:, columns]
            residuals = (projection.image_px - corners.image_px).ravel()
            w = np.repeat(weights[number][side], 2)
            weighted = w[:, None] * J
            normal[number] += weighted.T @ J
            gradient[number] += weighted.T @ residuals
            cost += float(w @ np.square(residuals))
    return NormalEquations(normal, gradient, cost)


def _cauchy_weights(residuals: list[tuple[F64, ...]]) -> list[tuple[F64, ...]]:
    distances = [tuple(np.linalg.norm(each, axis=1) for each in view) for view in residuals]
    median = np.median(np.concatenate([each for view in distances for each in view]))
    limit = max(_CAUCHY_SIGMAS * float(median) / 1.1774, 1e-9)  # the median of a Rayleigh distribution is 1.1774 sigma
    return [tuple(1 / (1 + np.square(each / limit)) for each in view) for view in distances]

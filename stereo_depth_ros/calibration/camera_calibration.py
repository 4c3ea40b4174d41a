# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of one camera from views of a board: initial parameters, solution, outlier views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.bundle_adjustment import BundleParameters, BundleSolution, adjust_bundle
from stereo_depth_ros.calibration.projection import MODELS, camera_matrix, project
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.rays import normalized_points
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = [
    "MIN_LIMIT_PX",
    "MIN_VIEWS",
    "CameraSolution",
    "DroppedView",
    "calibrate_camera",
    "initial_pose",
    "outlier_view",
    "too_few_views",
]

MIN_VIEWS = 5  # three views determine a pinhole camera; two more verify consistency
_FIELDS_OF_VIEW_DEG = (12, 20, 30, 40, 50, 60, 75, 90, 110, 130)  # horizontal, candidates for the initial camera
_WIDE_DEG = (45, 60, 80, 100, 120, 140, 160, 180, 200, 220)
_MAX_TANGENT = np.tan(np.radians(80))  # of the angle from the axis, of corners used for the initial pose
_MAX_SIGMAS, _MAX_RATIO = 6.0, 2.5  # a view is dropped above median + 6 sigma and 2.5 times the median of the others
MIN_LIMIT_PX = 0.1  # of the rms of a view: corners are not detected more exactly


@dataclass(frozen=True)
class DroppedView:
    """A view that was rejected, and the reason in one sentence."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class CameraSolution:
    """Calibration of one camera alone.

    Attributes:
        solution: over the views that are kept.
        kept: indices of those views.
        dropped: the other views.
    """

    solution: BundleSolution
    kept: list[int]
    dropped: list[DroppedView]


def calibrate_camera(
    names: Sequence[str],
    views: Sequence[Corners],
    size: tuple[int, int],
    model: str,
    side: str,
    *,
    least: int = MIN_VIEWS,
    fixed: tuple[int, ...] = (),
) -> CameraSolution:
    """Calibrate one camera from views of a flat board, without the views that do not fit.

    Args:
        names: of the views, for messages.
        views: the corners of each view.
        size: width, height of the images, px.
        model: distortion model.
        side: "left" or "right", for messages.
        least: number of views that have to agree.
        fixed: indices of intrinsic parameters that are held at their initial values; coefficients begin with 0.

    Raises:
        CalibrationError: too few views agree, or they do not determine the camera.
    """
    start, without_pose = _initial_parameters(views, size, model)
    start = replace(start, fixed=fixed)
    dropped = [
        DroppedView(names[number], f"{side}: no pose of the board explains its corners") for number in without_pose
    ]
    kept = [number for number in range(len(views)) if number not in without_pose]
    while True:
        if len(kept) < least:
            raise too_few_views(len(kept), dropped, least)
        solution = adjust_bundle([(views[number],) for number in kept], start, robust=True)
        worst = outlier_view(solution.view_rms_px(0))
        if worst is None:
            break
        at, reason = worst
        dropped.append(DroppedView(names[kept[at]], f"{side}: {reason}"))
        start = _without(solution.parameters, at)
        del kept[at]
    return CameraSolution(adjust_bundle([(views[number],) for number in kept], solution.parameters), kept, dropped)


def too_few_views(count: int, dropped: Sequence[DroppedView], least: int = MIN_VIEWS) -> CalibrationError:
    """The error for fewer views than a calibration needs."""
    without = f" ({len(dropped)} dropped: {'; '.join(f'{view.name}, {view.reason}' for view in dropped)})"
    return CalibrationError(
        f"{count} views of the board{without if dropped else ''}, at least {least} are required, 20 recommended",
        value=count,
        limit=least,
        remedy="record more pairs in which both cameras see the whole board, near and far, tilted, in all parts of the "
        "image",
    )


def outlier_view(view_rms_px: F64) -> tuple[int, str] | None:
    """Index of the view of largest rms and the reason, where it is an outlier among the others; else None."""
    at = int(np.argmax(view_rms_px))
    others = np.delete(view_rms_px, at)
    median = float(np.median(others))
    sigma = robust_sigma(others - median)
    limit = max(median + _MAX_SIGMAS * sigma, _MAX_RATIO * median, MIN_LIMIT_PX)
    if view_rms_px[at] <= limit:
        return None
    return (
        at,
        f"reprojection rms {view_rms_px[at]:.2f} px, median of the other views {median:.2f} px, limit {limit:.2f} px",
    )


def _without(parameters: BundleParameters, at: int) -> BundleParameters:
    return replace(parameters, poses=np.delete(parameters.poses, at, axis=0))


def _initial_parameters(
    views: Sequence[Corners], size: tuple[int, int], model: str
) -> tuple[BundleParameters, set[int]]:
    """Parameters with the focal length of least median rms and all coefficients 0; indices of views without a pose.

    Works where cv2.fisheye.calibrate fails because of one view and does not state which.
    """
    candidates = []
    for focal_px in _focal_lengths_px(model, size[0]):
        intrinsics = np.array([focal_px, focal_px, (size[0] - 1) / 2, (size[1] - 1) / 2, *[0.0] * len(MODELS[model])])
        fits = [initial_pose(model, intrinsics, corners) for corners in views]
        candidates.append((float(np.median([rms for _, rms in fits])), intrinsics, fits))
    _, intrinsics, fits = min(candidates, key=lambda candidate: candidate[0])
    without_pose = {number for number, (_, rms) in enumerate(fits) if not np.isfinite(rms)}
    poses = np.array([pose for pose, rms in fits if np.isfinite(rms)]).reshape(-1, 6)
    return BundleParameters(model, (intrinsics,), np.zeros(6), poses), without_pose


def _focal_lengths_px(model: str, width: int) -> F64:
    if model == "equidistant":
        return width / np.radians(_WIDE_DEG)
    return np.asarray(width / 2 / np.tan(np.radians(_FIELDS_OF_VIEW_DEG) / 2), np.float64)


def initial_pose(model: str, intrinsics: F64, corners: Corners) -> tuple[F64, float]:
    """Board pose by a method for planes (IPPE) and its rms, px; the rms is infinite where no pose is found.

    Args:
        model: distortion model.
        intrinsics: float64 (4 + n,): fx, fy, cx, cy in px, coefficients.
        corners: of the board.

    Returns:
        float64 (6,), rotation vector and translation in meters from the board to the camera, and the rms.
    """
    none = np.zeros(6), np.inf
    rays = normalized_points(corners.image_px, model, camera_matrix(intrinsics), intrinsics[4:])
    usable = np.linalg.norm(rays, axis=1) < _MAX_TANGENT
    if usable.sum() < 4:
        return none
    points, rays = corners.board_m[usable].reshape(-1, 1, 3), rays[usable].reshape(-1, 1, 2)
    try:
        found, rotation, translation = cv2.solvePnP(points, rays, np.identity(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:  # collinear points
        return none
    if not found:
        return none
    pose = np.concatenate([rotation.ravel(), translation.ravel()])
    if not np.isfinite(pose).all() or pose[5] <= 0:
        return none
    errors = project(model, intrinsics, pose, corners.board_m).image_px - corners.image_px
    rms = float(np.sqrt(np.square(errors).sum(axis=1).mean()))
    return (pose, rms) if np.isfinite(rms) else none

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One camera from views of a board: a first guess for any lens, the solution, views that do not fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.bundle_adjustment import BundleAdjustment, Estimate, adjust_bundle
from stereo_depth_ros.calibration.projection import MODELS, camera_matrix, project
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.rays import normalized_points

__all__ = ["MIN_LIMIT_PX", "MIN_VIEWS", "DroppedView", "OneCamera", "calibrate_camera", "worst_view"]

MIN_VIEWS = 5  # 3 determine a pinhole; two more show that they agree
_FIELDS_OF_VIEW_DEG = (12, 20, 30, 40, 50, 60, 75, 90, 110, 130)  # across, of lenses to begin with
_WIDE_DEG = (45, 60, 80, 100, 120, 140, 160, 180, 200, 220)
_MAX_TANGENT = np.tan(np.radians(80))  # of the angle from the axis, of corners that a first guess uses
_SPREADS, _TIMES = 6.0, 2.5  # a view is dropped above the others' median + 6 sigma and above 2.5 times their median
MIN_LIMIT_PX = 0.1  # whatever the others': no corner is found better


@dataclass(frozen=True)
class DroppedView:
    """A view that was left out, and why, in one sentence."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class OneCamera:
    """A camera by itself.

    Attributes:
        adjustment: the solution over the views that are kept.
        kept: numbers of those views.
        dropped: the others.
    """

    solution: BundleAdjustment
    kept: list[int]
    dropped: list[DroppedView]


def calibrate_camera(
    names: Sequence[str], views: Sequence[Corners], size: tuple[int, int], model: str, side: str
) -> OneCamera:
    """The camera from views of a flat board.

    Args:
        names: of the views, for messages.
        views: the corners of each.
        size: width, height of the images, px.
        model: distortion model.
        camera: "left" or "right", for messages.

    Raises:
        CalibrationError: too few views agree, or they do not determine the camera.
    """
    start, lost = _first_guess(views, size, model)
    dropped = [DroppedView(names[number], f"{side}: no pose of the board explains its corners") for number in lost]
    kept = [number for number in range(len(views)) if number not in lost]
    while True:
        if len(kept) < MIN_VIEWS:
            raise too_few(len(kept), dropped)
        solution = adjust_bundle([(views[number],) for number in kept], start, robust=True)
        worst = worst_view(solution.view_rms_px(0))
        if worst is None:
            break
        at, reason = worst
        dropped.append(DroppedView(names[kept[at]], f"{side}: {reason}"))
        start = _without(solution.estimate, at)
        del kept[at]
    return OneCamera(adjust_bundle([(views[number],) for number in kept], solution.estimate), kept, dropped)


def too_few(count: int, dropped: Sequence[DroppedView]) -> CalibrationError:
    """The error of fewer views than a calibration takes."""
    without = f" ({len(dropped)} dropped: {'; '.join(f'{view.name}, {view.reason}' for view in dropped)})"
    return CalibrationError(
        f"{count} views of the board{without if dropped else ''}, at least {MIN_VIEWS} are needed and 20 are good: "
        "take more pairs in which both cameras see the whole board, near and far, tilted, in all parts of the image"
    )


def worst_view(view_rms_px: F64) -> tuple[int, str] | None:
    """The view that fits least, where it is far from what the others scatter; and the reason in words."""
    at = int(np.argmax(view_rms_px))
    others = np.delete(view_rms_px, at)
    median = float(np.median(others))
    sigma = 1.4826 * float(np.median(np.abs(others - median)))
    limit = max(median + _SPREADS * sigma, _TIMES * median, MIN_LIMIT_PX)
    if view_rms_px[at] <= limit:
        return None
    return at, f"reprojection rms {view_rms_px[at]:.2f} px, the other views have {median:.2f} px (limit {limit:.2f} px)"


def _without(estimate: Estimate, at: int) -> Estimate:
    return replace(estimate, poses=np.delete(estimate.poses, at, axis=0))


def _first_guess(views: Sequence[Corners], size: tuple[int, int], model: str) -> tuple[Estimate, set[int]]:
    """A lens without distortion whose focal length explains the views best, and the views it cannot explain at all.

    The coefficients begin at 0, which for "equidistant" is a fisheye. Works where cv2.fisheye.calibrate gives up on one
    view and does not say which.
    """
    guesses = []
    for focal_px in _focal_lengths_px(model, size[0]):
        intrinsics = np.array([focal_px, focal_px, (size[0] - 1) / 2, (size[1] - 1) / 2, *[0.0] * len(MODELS[model])])
        fits = [_first_pose(model, intrinsics, corners) for corners in views]
        guesses.append((float(np.median([rms for _, rms in fits])), intrinsics, fits))
    _, intrinsics, fits = min(guesses, key=lambda guess: guess[0])
    lost = {number for number, (_, rms) in enumerate(fits) if not np.isfinite(rms)}
    poses = np.array([pose for pose, rms in fits if np.isfinite(rms)]).reshape(-1, 6)
    return Estimate(model, (intrinsics,), np.zeros(6), poses), lost


def _focal_lengths_px(model: str, width: int) -> F64:
    if model == "equidistant":
        return width / np.radians(_WIDE_DEG)
    return np.asarray(width / 2 / np.tan(np.radians(_FIELDS_OF_VIEW_DEG) / 2), np.float64)


def _first_pose(model: str, intrinsics: F64, corners: Corners) -> tuple[F64, float]:
    """Pose and rms in px by a method for planes; infinite where there is none."""
    none = np.zeros(6), np.inf
    rays = normalized_points(corners.image_px, model, camera_matrix(intrinsics), intrinsics[4:])
    usable = np.linalg.norm(rays, axis=1) < _MAX_TANGENT
    if usable.sum() < 4:
        return none
    points, rays = corners.board_m[usable].reshape(-1, 1, 3), rays[usable].reshape(-1, 1, 2)
    try:
        found, rotation, translation = cv2.solvePnP(points, rays, np.identity(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:  # the points are on a line
        return none
    if not found:
        return none
    pose = np.concatenate([rotation.ravel(), translation.ravel()])
    if not np.isfinite(pose).all() or pose[5] <= 0:
        return none
    errors = project(model, intrinsics, pose, corners.board_m).image_px - corners.image_px
    rms = float(np.sqrt(np.square(errors).sum(axis=1).mean()))
    return (pose, rms) if np.isfinite(rms) else none

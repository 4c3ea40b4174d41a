# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""First estimates of a camera and a projector from poses of a board, without the poses that do not fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np

from stereo_depth_ros.active.projector.raster import Size
from stereo_depth_ros.active.projector.resection import Resection, projection_errors_px, resect
from stereo_depth_ros.calibration.board_views import BoardView
from stereo_depth_ros.calibration.bundle_adjustment import BundleParameters, adjust_bundle
from stereo_depth_ros.calibration.camera_calibration import (
    CameraSolution,
    DroppedView,
    calibrate_camera,
    initial_pose,
    outlier_view,
)
from stereo_depth_ros.calibration.distortion_range import ensure_monotonic_distortion
from stereo_depth_ros.calibration.projection import MODELS, parameter_names
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64

__all__ = [
    "MIN_POSES",
    "MIN_POSES_KNOWN_CAMERA",
    "first_projector",
    "in_camera",
    "known_camera",
    "new_camera",
    "too_few_poses",
]

MIN_POSES, MIN_POSES_KNOWN_CAMERA = 3, 2
_ALL_COEFFICIENTS_POSES = 5  # fewer do not determine k3 and above
_MORE_POSES = (
    "capture the patterns on the board in more poses, tilted by 30 degrees to all sides, near and far, where the "
    "projector lights all of it"
)
_MOST_PAIRS = 45  # of poses, from which the projector is first estimated
_LARGEST_START_PX = 50.0  # median error of that estimate, above which no pair of poses agrees with the others
_OUTLIER_RATIO, _LEAST_LIMIT_PX = 10.0, 20.0  # of the median error of a pose; two poses extrapolate to the others


def too_few_poses(count: int, dropped: Sequence[DroppedView], camera_known: bool) -> CalibrationError:
    """The error for fewer poses than a calibration needs."""
    least = MIN_POSES_KNOWN_CAMERA if camera_known else MIN_POSES
    what = "a projector with a known camera" if camera_known else "camera and projector"
    without = f" ({len(dropped)} dropped: {'; '.join(f'{view.name}, {view.reason}' for view in dropped)})"
    by_camera = not camera_known and count >= MIN_POSES_KNOWN_CAMERA
    return CalibrationError(
        f"{count} pose{'s' * (count != 1)} of the board{without if dropped else ''}, at least {least} are required for "
        f"{what}, 10 recommended",
        value=count,
        limit=least,
        remedy=_MORE_POSES + (", or give the calibration of the camera" if by_camera else ""),
        settings=("camera",) if by_camera else (),
    )


def new_camera(views: Sequence[BoardView], size: Size, model: str) -> CameraSolution:
    """The camera alone; of few poses with fewer coefficients."""
    names = parameter_names(model)
    few = len(views) < _ALL_COEFFICIENTS_POSES
    fixed = tuple(names.index(name) for name in MODELS[model] if few and name[0] == "k" and name not in ("k1", "k2"))
    corners = [view.left for view in views]
    try:
        alone = calibrate_camera(
            [view.name for view in views], corners, size, model, "camera", least=MIN_POSES, fixed=fixed
        )
    except CalibrationError as error:
        raise error.about("camera", _MORE_POSES) from error
    kept = [(corners[number],) for number in alone.kept]
    return replace(alone, solution=ensure_monotonic_distortion(kept, alone.solution, size, (None,)))


def known_camera(views: Sequence[BoardView], size: Size, model: str, camera: CameraModel) -> CameraSolution:
    """The board poses in a given camera, without the poses that do not fit."""
    if (camera.width, camera.height) != size:
        raise CalibrationError(
            f"the camera is calibrated for {camera.width}x{camera.height}, the images are {size[0]}x{size[1]}",
            value=(camera.width, camera.height),
            limit=size,
            remedy="give the calibration of this resolution",
            settings=("camera",),
        )
    K, count = camera.K, len(MODELS[model])
    D = np.concatenate((camera.D, np.zeros(count)))[:count]
    intrinsics = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D])
    kept, dropped = list(range(len(views))), []
    poses = [initial_pose(model, intrinsics, view.left) for view in views]
    for number, (_, rms) in enumerate(poses):
        if not np.isfinite(rms):
            dropped.append(DroppedView(views[number].name, "camera: no pose of the board explains its corners"))
            kept.remove(number)
    while len(kept) > MIN_POSES_KNOWN_CAMERA and (worst := outlier_view(np.array([poses[n][1] for n in kept]))):
        dropped.append(DroppedView(views[kept[worst[0]]].name, f"camera: {worst[1]}"))
        del kept[worst[0]]
    if len(kept) < MIN_POSES_KNOWN_CAMERA:
        raise too_few_poses(len(kept), dropped, True)
    start = BundleParameters(
        model, (intrinsics,), np.zeros(6), np.array([poses[n][0] for n in kept]), held=tuple(range(intrinsics.size))
    )
    return CameraSolution(adjust_bundle([(views[n].left,) for n in kept], start), kept, dropped)


def first_projector(
    views: list[BoardView], camera: BundleParameters, camera_known: bool, dropped: list[DroppedView], least: int
) -> tuple[BundleParameters, list[BoardView]]:
    """Parameters with a first projector, a pinhole, and the poses that agree with it.

    Each pair of poses determines a projector; the one with the least median error over all poses is taken, so that
    poses with a wrong code do not count (least median of squares, Rousseeuw 1984).
    """
    points = [in_camera(pose, view) for pose, view in zip(camera.poses, views, strict=True)]
    pairs = list(combinations(range(len(views)), 2))
    best: tuple[float, Resection | None] = (np.inf, None)
    failure: CalibrationError | None = None
    for pair in pairs[:: max(1, len(pairs) // _MOST_PAIRS)]:
        try:
            found = resect(np.concatenate([points[n] for n in pair]), _pixels([views[n] for n in pair]))
        except CalibrationError as error:
            failure = error
            continue
        medians = [_median_error(found, *each) for each in zip(points, views, strict=True)]
        best = min(best, (float(np.median(medians)), found), key=lambda each: each[0])
    if best[1] is None:
        assert failure is not None
        raise failure
    medians = [_median_error(best[1], *each) for each in zip(points, views, strict=True)]
    limit = max(_OUTLIER_RATIO * best[0], _LEAST_LIMIT_PX)
    if best[0] > _LARGEST_START_PX:
        raise CalibrationError(
            f"no projector explains two of the poses and the others, the median error is {best[0]:.0f} px, limit "
            f"{_LARGEST_START_PX:g} px",
            value=best[0],
            limit=_LARGEST_START_PX,
            remedy="keep camera and projector fixed to each other, the board still during a sequence, and list the "
            "images in the order in which they were captured",
        )
    kept = [number for number, median in enumerate(medians) if median <= limit]
    for number in sorted({*range(len(views))} - {*kept}):
        text = f"projector: median error {medians[number]:.1f} px, limit {limit:.1f} px: its code is wrong, or camera "
        dropped.append(DroppedView(views[number].name, f"{text}and projector moved against each other"))
    if len(kept) < least:
        raise too_few_poses(len(kept), dropped, camera_known)
    views = [views[number] for number in kept]
    P = resect(np.concatenate([points[n] for n in kept]), _pixels(views))
    K, R, T = P.decomposed()
    count = len(MODELS[camera.model])
    projector = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *[0.0] * count])
    first = camera.intrinsics[0].size
    held = set(range(first)) if camera_known else {*camera.fixed}
    held |= set(range(first + 4, first + 4 + count))
    rig = np.concatenate([cv2.Rodrigues(R)[0].ravel(), T])
    intrinsics = (camera.intrinsics[0], projector)
    return BundleParameters(camera.model, intrinsics, rig, camera.poses[kept], held=tuple(sorted(held))), views


def in_camera(pose: F64, view: BoardView) -> F64:
    """The corners that the projector lights, in the frame of the camera, float64 (N, 3), meters."""
    points: F64 = view.right.board_m @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
    return points


def _pixels(views: Sequence[BoardView]) -> F64:
    return np.concatenate([view.right.image_px for view in views])


def _median_error(found: Resection, points: F64, view: BoardView) -> float:
    return float(np.median(projection_errors_px(found.P, points, view.right.image_px)))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a projector, and of its camera, from poses of a board: the projector is an inverse camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from stereo_depth_ros.active.projector.distortion import determined_coefficients
from stereo_depth_ros.active.projector.first_estimate import (
    MIN_POSES,
    MIN_POSES_KNOWN_CAMERA,
    first_projector,
    in_camera,
    known_camera,
    new_camera,
    too_few_poses,
)
from stereo_depth_ros.active.projector.raster import Size, resized_points
from stereo_depth_ros.active.projector.rectification import rectify_camera_and_projector
from stereo_depth_ros.active.projector.result import ProjectorCalibration
from stereo_depth_ros.calibration.board_views import BoardView, Coverage, placement
from stereo_depth_ros.calibration.boards import MIN_CORNERS
from stereo_depth_ros.calibration.bundle_adjustment import BundleParameters, BundleSolution, adjust_bundle
from stereo_depth_ros.calibration.calibration_result import CalibratedCamera, StereoCalibration
from stereo_depth_ros.calibration.camera_calibration import MIN_LIMIT_PX, CameraSolution, DroppedView, outlier_view
from stereo_depth_ros.calibration.distortion_range import zeroed_coefficients
from stereo_depth_ros.calibration.projection import distortion_range_px, parameter_names
from stereo_depth_ros.calibration.stereo_calibration import (
    calibrated_camera,
    check_determined,
    row_errors_px,
    view_errors,
)
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.rig import MAX_BASELINE_M, MIN_BASELINE_M
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.relative_pose import RelativePose

__all__ = ["PROJECTOR_MODELS", "calibrate_projector"]

PROJECTOR_MODELS = ("plumb_bob", "rational_polynomial")  # of lenses that show straight lines nearly straight
_JACKKNIFE_POSES = 4  # from which leaving one out tells how exact the others are
_WARN_RATIO = 2.0  # of the rms with the other to that alone
_SIDES = ("camera", "projector")


def calibrate_projector(
    views: Sequence[BoardView], projector_size: Size, model: str = "plumb_bob", camera: CameraModel | None = None
) -> ProjectorCalibration:
    """Calibrate a projector and its camera from poses of a board.

    D. Moreno and G. Taubin, Simple, accurate, and robust projector-camera calibration, 3DIMPVT 2012: the corners of
    the board in the image of the projector make it a camera, and both a stereo rig. The camera is calibrated alone,
    or given. Its board poses place all corners in its frame, where they are not in one plane, so that the projector
    follows linearly (:func:`resect`) wherever its principal point is: with a lens shift it is outside of the image.
    Bundle adjustment then refines everything together. Outlier poses are dropped one at a time, the worst first.

    Distortion coefficients of the projector are free if they predict poses that are left out better
    (:func:`determined_coefficients`); the others are 0.

    Args:
        views: poses; left are the corners in the raw image of the camera, right those in the projector, in its px,
            which may be fewer.
        projector_size: width, height of the projector, px.
        model: distortion model of both, plumb_bob or rational_polynomial; with ``camera`` it is that of the camera.
        camera: K and D of the camera where it is calibrated already.

    Raises:
        ConfigError: another model.
        CalibrationError: too few poses, or poses that do not determine camera or projector; the camera is for another
            size; the board is too large or too small.
    """
    model = _model(model, camera)
    size = views[0].size if views else (0, 0)
    least = MIN_POSES if camera is None else MIN_POSES_KNOWN_CAMERA
    usable, dropped = _usable(views)
    if len(usable) < least:
        raise too_few_poses(len(usable), dropped, camera is not None)
    alone = known_camera(usable, size, model, camera) if camera else new_camera(usable, size, model)
    dropped += alone.dropped
    kept = [usable[number] for number in alone.kept]
    start, kept = first_projector(kept, alone.solution.parameters, camera is not None, dropped, least)
    solution, kept = _solve(kept, start, dropped, camera is not None, least)
    return _result(kept, solution, alone, dropped, projector_size, camera is not None)


def _model(model: str, camera: CameraModel | None) -> str:
    found = model if camera is None else camera.distortion_model
    if found not in PROJECTOR_MODELS:
        raise ConfigError(
            f"model {found!r} is not one of {', '.join(PROJECTOR_MODELS)}, which a camera beside a projector may have",
            value=found,
            limit=PROJECTOR_MODELS,
            remedy="use plumb_bob, or rational_polynomial for a wide-angle lens",
            settings=("model",) if camera is None else ("camera",),
        )
    return found


def _usable(views: Sequence[BoardView]) -> tuple[list[BoardView], list[DroppedView]]:
    """The poses of one size of which the projector lights enough corners."""
    usable, dropped, size = [], [], views[0].size if views else (0, 0)
    for view in views:
        if view.size != size:
            raise CalibrationError(
                f"image size {view.size[0]}x{view.size[1]}, {views[0].name} is {size[0]}x{size[1]}, a calibration is "
                "for one image size",
                subject=view.name,
                value=view.size,
                limit=size,
                remedy="capture all poses at the same resolution",
            )
        if len(view.right.ids) >= MIN_CORNERS:
            usable.append(view)
            continue
        dropped.append(
            DroppedView(
                view.name,
                f"projector: {len(view.right.ids)} of {len(view.left.ids)} corners are surrounded by decoded pixels, "
                f"{MIN_CORNERS} are needed",
            )
        )
    return usable, dropped


def _solve(
    views: list[BoardView],
    start: BundleParameters,
    dropped: list[DroppedView],
    camera_known: bool,
    least: int,
) -> tuple[BundleSolution, list[BoardView]]:
    """Bundle adjustment of camera and projector, without the poses that do not fit."""
    while True:
        pairs = [(view.left, view.right) for view in views]
        solution = adjust_bundle(pairs, _with_coefficients(views, start), robust=len(views) > MIN_POSES)
        rms_px = np.hypot(solution.view_rms_px(0), solution.view_rms_px(1)) / np.sqrt(2)
        worst = outlier_view(rms_px) if len(views) > MIN_POSES else None
        if worst is None:
            return adjust_bundle(pairs, solution.parameters), views
        at, reason = worst
        text = f"camera and projector: {reason}; the camera alone fits, so the codes are wrong, or one was moved"
        dropped.append(DroppedView(views[at].name, text))
        views = [view for number, view in enumerate(views) if number != at]
        start = replace(start, poses=np.delete(start.poses, at, axis=0))
        if len(views) < least:
            raise too_few_poses(len(views), dropped, camera_known)


def _with_coefficients(views: Sequence[BoardView], start: BundleParameters) -> BundleParameters:
    """The parameters with the coefficients of the projector free that the poses determine."""
    first, names = start.intrinsics[0].size, parameter_names(start.model)
    points_m = [in_camera(pose, view) for pose, view in zip(start.poses, views, strict=True)]
    image_px = [view.right.image_px for view in views]
    free = determined_coefficients(start.model, start.intrinsics[1], start.rig, points_m, image_px)
    freed = {first + names.index(name) for name in free}
    return replace(start, held=tuple(number for number in start.held if number not in freed))


def _zero_coefficients(parameters: BundleParameters) -> tuple[str, ...]:
    """Names of the coefficients of the projector that are held at 0."""
    first, names = parameters.intrinsics[0].size, parameter_names(parameters.model)
    return tuple(names[number - first] for number in parameters.held if number >= first)


def _sigmas(solution: BundleSolution, poses: int) -> F64:
    """Standard deviations of the shared parameters; of few poses only from their corners."""
    few = replace(solution, view_covariance=np.zeros_like(solution.view_covariance))
    return (few if poses < _JACKKNIFE_POSES else solution).sigmas


def _result(
    views: list[BoardView],
    solution: BundleSolution,
    alone: CameraSolution,
    dropped: list[DroppedView],
    projector_size: Size,
    camera_known: bool,
) -> ProjectorCalibration:
    parameters, size = solution.parameters, views[0].size
    sigmas = _sigmas(solution, len(views))
    alone_px = (alone.solution.rms_px(), _projector_alone_px(views, parameters))
    cameras = [calibrated_camera(solution, side, sigmas, alone_px[side]) for side in (0, 1)]
    check_determined(cameras, _SIDES)
    R, T = cv2.Rodrigues(parameters.rig[:3])[0], parameters.rig[3:]
    _check_baseline(T)
    models = [
        CameraModel(*each, parameters.model, one.K, one.D, np.identity(3), np.identity(4)[:3], "left_optical_frame")
        for each, one in zip((size, projector_size), cameras, strict=True)
    ]
    rig = rectify_camera_and_projector(models[0], models[1], RelativePose(R, T))
    rows = [row_errors_px(rig, _resized(view, projector_size)) for view in views]
    along = np.concatenate([np.zeros(len(sigmas) - 3), T / np.linalg.norm(T)])
    stereo = StereoCalibration(
        model=parameters.model,
        left=cameras[0],
        right=cameras[1],
        R=R,
        T=T,
        R_sigma_deg=np.degrees(sigmas[-6:-3]),
        T_sigma_m=sigmas[-3:],
        baseline_sigma_m=float(np.sqrt(along @ solution.covariance @ along))
        if len(views) < _JACKKNIFE_POSES
        else solution.sigma(along),
        rms_stereo_px=solution.rms_px(),
        epipolar_rms_px=float(np.sqrt(np.square(np.concatenate(rows)).mean())),
        rig=rig,
        views=tuple(view_errors(solution, views, rows)),
        dropped=tuple(dropped),
        coverage=Coverage.of([placement(view.left, size) for view in views]),
        warnings=tuple(_warnings(alone.solution.parameters, cameras, len(views), (size, projector_size), camera_known)),
    )
    return ProjectorCalibration(stereo, projector_size, camera_known, _zero_coefficients(parameters))


def _projector_alone_px(views: Sequence[BoardView], together: BundleParameters) -> float:
    """Reprojection rms of the projector as a camera of its own, whose board poses are free, px."""
    first = together.intrinsics[0].size
    poses = np.array(
        [
            np.concatenate([part.ravel() for part in cv2.composeRT(*_parts(pose), *_parts(together.rig))[:2]])
            for pose in together.poses
        ]
    )
    held = tuple(n - first for n in together.held if n >= first)
    if len(views) < MIN_POSES:  # their homographies do not determine more than the poses
        held = tuple(range(together.intrinsics[1].size))
    start = BundleParameters(together.model, together.intrinsics[1:], np.zeros(6), poses, held=held)
    return adjust_bundle([(view.right,) for view in views], start).rms_px()


def _parts(pose: F64) -> tuple[F64, F64]:
    return pose[:3], pose[3:]


def _resized(view: BoardView, projector_size: Size) -> BoardView:
    """With the corners in the projector as the rig stores it."""
    image_px = resized_points(view.right.image_px, projector_size, view.size)
    return replace(view, right=replace(view.right, image_px=image_px))


def _check_baseline(T: F64) -> None:
    baseline_m = float(np.linalg.norm(T))
    if not MIN_BASELINE_M <= baseline_m <= MAX_BASELINE_M:
        raise CalibrationError(
            f"the calibrated distance of camera and projector is {baseline_m:g} m, outside {MIN_BASELINE_M:g}.."
            f"{MAX_BASELINE_M:g} m",
            value=baseline_m,
            limit=(MIN_BASELINE_M, MAX_BASELINE_M),
            remedy="enter the side of a square in meters: 25 mm is 0.025",
            settings=("square",),
        )


def _warnings(
    camera: BundleParameters,
    cameras: Sequence[CalibratedCamera],
    poses: int,
    sizes: tuple[Size, Size],
    camera_known: bool,
) -> Iterator[str]:
    if poses < _JACKKNIFE_POSES:
        yield (
            f"{poses} poses: the standard deviations are those of the corners alone, as so few poses hardly check each "
            "other; they do not include the coefficients that are 0: 10 poses are recommended"
        )
    if not camera_known and (names := ", ".join(zeroed_coefficients(camera))):
        yield f"the poses do not determine {names} of the camera, fixed at 0: show the board near its image edges"
    for side, one in zip(_SIDES, cameras, strict=True):
        if one.rms_px > _WARN_RATIO * max(one.rms_alone_px, MIN_LIMIT_PX):
            yield (
                f"{side}: rms {one.rms_px:.2f} px with the other, {one.rms_alone_px:.2f} px alone: camera and "
                "projector moved against each other between the poses, or were zoomed or focused"
            )
    for side, one, of_size in zip(_SIDES, cameras, sizes, strict=True):
        intrinsics = np.array([*one.K[[0, 1, 0, 1], [0, 1, 2, 2]], *one.D])
        range_px, corner_px = distortion_range_px(camera.model, intrinsics, of_size)
        if range_px < corner_px:
            yield (
                f"{side}: the distortion decreases beyond {range_px:.0f} px from the principal point, the image "
                f"corners are at {corner_px:.0f} px: show the board there"
            )

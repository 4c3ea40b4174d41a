# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a stereo rig from views of a board: both cameras and their relative pose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from stereo_depth_ros.calibration.board_views import BoardView, Coverage, ViewCollector, placement
from stereo_depth_ros.calibration.bundle_adjustment import BundleParameters, BundleSolution, adjust_bundle
from stereo_depth_ros.calibration.calibration_result import CalibratedCamera, StereoCalibration, ViewErrors
from stereo_depth_ros.calibration.camera_calibration import (
    MIN_LIMIT_PX,
    MIN_VIEWS,
    CameraSolution,
    DroppedView,
    calibrate_camera,
    outlier_view,
    too_few_views,
)
from stereo_depth_ros.calibration.circle_rectification import rectified_in_circles
from stereo_depth_ros.calibration.distortion_range import (
    Circles,
    check_distortion_range,
    ensure_monotonic_distortion,
    needed_range_px,
    zeroed_coefficients,
)
from stereo_depth_ros.calibration.projection import camera_matrix, check_model, distortion_range_px
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import MAX_BASELINE_M, MIN_BASELINE_M, StereoRig
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.rays import rectify_points

__all__ = ["calibrate", "calibrated_camera", "check_determined", "relative_pose", "row_errors_px", "view_errors"]

MIN_DIFFERENT = 3  # views that determine a pinhole camera
_MAX_FOCAL_SIGMA = 0.05  # of the focal length: above it the views do not determine the focal length
_WARN_RATIO = 2.0  # of the rms of both cameras to that of one alone, above which the two images of a view disagree
_SIDES = ("left camera", "right camera")
_MAX_RATIO = 10.0  # of those, above which the images are not synchronized


def calibrate(
    views: Sequence[BoardView], model: str = "plumb_bob", circles: Circles = (None, None)
) -> StereoCalibration:
    """Calibrate a stereo rig from views of a board.

    Each camera is calibrated alone, then all parameters of both by bundle adjustment. Outlier views are dropped one at
    a time, the worst first.

    Args:
        views: of one board, in images of one size.
        model: "plumb_bob", "rational_polynomial" or "equidistant".
        circles: image circles of the lenses, see :class:`LitPixels`; the coverage and the distortion are judged within
            them, and the rectified images of a fisheye show nothing from outside.

    Raises:
        ConfigError: an unknown model.
        CalibrationError: too few views fit, they do not determine the cameras, or the baseline is out of range.
    """
    check_model(model)
    size = _common_size(views)
    _check_different(views)
    names = [view.name for view in views]
    left = calibrate_camera(names, [view.left for view in views], size, model, "left")
    right = calibrate_camera(names, [view.right for view in views], size, model, "right")
    kept = sorted(set(left.kept) & set(right.kept))
    dropped = [*left.dropped, *(view for view in right.dropped if view.name not in {one.name for one in left.dropped})]
    kept, start = _initial_rig(left, right, kept, dropped)
    solution, kept = _solve(views, kept, start, dropped)
    alone_px = (left.solution.rms_px(), right.solution.rms_px())
    _check_together(solution, alone_px, len(kept), len(views))
    solution = ensure_monotonic_distortion(
        [(views[number].left, views[number].right) for number in kept], solution, size, circles
    )
    return _result(views, kept, dropped, solution, alone_px, size, circles)


def _common_size(views: Sequence[BoardView]) -> tuple[int, int]:
    if len(views) < MIN_VIEWS:
        raise too_few_views(len(views), ())
    first = views[0]
    for view in views:
        if view.size != first.size:
            raise CalibrationError(
                f"image size {view.size[0]}x{view.size[1]}, {first.name} is {first.size[0]}x{first.size[1]}, a "
                "calibration is for one image size",
                subject=view.name,
                value=view.size,
                limit=first.size,
                remedy="record all images at the same resolution",
            )
    return first.size


def _check_different(views: Sequence[BoardView]) -> None:
    """Repeated views of one board pose fit any camera."""
    collector = ViewCollector()
    different = sum([collector.add(view) for view in views])
    if different < MIN_DIFFERENT:
        raise CalibrationError(
            f"{different} of {len(views)} views differ, at least {MIN_DIFFERENT} are needed",
            value=different,
            limit=MIN_DIFFERENT,
            remedy="tilt the board about both axes and move it to all parts of the image",
        )


def _initial_rig(
    left: CameraSolution, right: CameraSolution, kept: list[int], dropped: list[DroppedView]
) -> tuple[list[int], BundleParameters]:
    """Views in both calibrations; their parameters, with the median of the relative poses of the views."""
    if len(kept) < MIN_VIEWS:
        raise too_few_views(len(kept), dropped)
    poses = [np.array([one.solution.parameters.poses[one.kept.index(n)] for n in kept]) for one in (left, right)]
    rigs = np.array([relative_pose(*pair) for pair in zip(*poses, strict=True)])
    intrinsics = (left.solution.parameters.intrinsics[0], right.solution.parameters.intrinsics[0])
    return kept, BundleParameters(left.solution.parameters.model, intrinsics, np.median(rigs, axis=0), poses[0])


def relative_pose(left: F64, right: F64) -> F64:
    """Rotation vector and translation from the left to the right camera, from the poses of one board in both."""
    R_left, R_right = cv2.Rodrigues(left[:3])[0], cv2.Rodrigues(right[:3])[0]
    R = R_right @ R_left.T
    return np.concatenate([cv2.Rodrigues(R)[0].ravel(), right[3:] - R @ left[3:]])


def _solve(
    views: Sequence[BoardView], kept: list[int], start: BundleParameters, dropped: list[DroppedView]
) -> tuple[BundleSolution, list[int]]:
    """Bundle adjustment of both cameras without the views whose two images were not exposed together."""
    while True:
        pairs = [(views[number].left, views[number].right) for number in kept]
        solution = adjust_bundle(pairs, start, robust=True)
        worst = outlier_view(np.hypot(solution.view_rms_px(0), solution.view_rms_px(1)) / np.sqrt(2))
        if worst is None:
            return adjust_bundle(pairs, solution.parameters), kept
        at, reason = worst
        text = (
            f"both cameras: {reason}; each camera alone fits, so the board or the rig moved between the two exposures"
        )
        dropped.append(DroppedView(views[kept[at]].name, text))
        kept = [number for number in kept if number != kept[at]]
        if len(kept) < MIN_VIEWS:
            raise too_few_views(len(kept), dropped)
        start = replace(solution.parameters, poses=np.delete(solution.parameters.poses, at, axis=0))


def _check_together(solution: BundleSolution, alone_px: tuple[float, float], used: int, count: int) -> None:
    for number, side in enumerate(("left", "right")):
        rms_px, alone = solution.rms_px(number), alone_px[number]
        limit_px = _MAX_RATIO * max(alone, MIN_LIMIT_PX)
        if rms_px > limit_px:
            raise CalibrationError(
                f"rms {rms_px:.2f} px with the other camera, {alone:.2f} px alone, limit {limit_px:.2f} px, in {used} "
                f"of {count} views: the two images of a pair do not belong together",
                subject=f"{side} camera",
                value=rms_px,
                limit=limit_px,
                remedy="pair images that were exposed at the same time by one rig",
            )


def _result(
    views: Sequence[BoardView],
    kept: list[int],
    dropped: list[DroppedView],
    solution: BundleSolution,
    alone_px: tuple[float, float],
    size: tuple[int, int],
    circles: Circles,
) -> StereoCalibration:
    parameters = solution.parameters
    sigmas = solution.sigmas
    cameras = [calibrated_camera(solution, side, sigmas, alone_px[side]) for side in (0, 1)]
    check_determined(cameras)
    R, T = cv2.Rodrigues(parameters.rig[:3])[0], parameters.rig[3:]
    _check_baseline(T)
    check_distortion_range(parameters, size, circles)
    left, right = cameras
    if parameters.model == "equidistant" and any(circles):
        rig = rectified_in_circles(parameters, R, T, size, circles)
    else:
        rig = StereoRig.from_calibration(left.K, left.D, right.K, right.D, R, T, size, parameters.model)
    used = [views[number] for number in kept]
    rows = [row_errors_px(rig, view) for view in used]
    errors_px = np.concatenate(rows)
    if not errors_px.size:
        raise CalibrationError(
            "the cameras see no corner of the board in common in any view",
            remedy="hold the board where both cameras see the same part of it",
        )
    along = np.concatenate([np.zeros(len(sigmas) - 3), T / np.linalg.norm(T)])
    return StereoCalibration(
        model=parameters.model,
        left=left,
        right=right,
        R=R,
        T=T,
        R_sigma_deg=np.degrees(sigmas[-6:-3]),
        T_sigma_m=sigmas[-3:],
        baseline_sigma_m=solution.sigma(along),
        rms_stereo_px=solution.rms_px(),
        epipolar_rms_px=float(np.sqrt(np.square(errors_px).mean())),
        rig=rig,
        views=tuple(view_errors(solution, used, rows)),
        dropped=tuple(dropped),
        circles=circles,
        coverage=Coverage.of([placement(view.left, size, circles[0]) for view in used]),
        warnings=tuple(_warnings(parameters, cameras, size, circles)),
    )


def calibrated_camera(solution: BundleSolution, side: int, sigmas: F64, alone_px: float) -> CalibratedCamera:
    """One camera of a solution.

    Args:
        solution: of one or two cameras.
        side: index of the camera.
        sigmas: float64 (S,), standard deviations of the shared parameters.
        alone_px: reprojection rms of this camera alone.
    """
    intrinsics = solution.parameters.intrinsics[side]
    own = sigmas[side * intrinsics.size : (side + 1) * intrinsics.size]
    return CalibratedCamera(camera_matrix(intrinsics), intrinsics[4:], own, solution.rms_px(side), alone_px)


def check_determined(cameras: Sequence[CalibratedCamera], names: Sequence[str] = _SIDES) -> None:
    """Raise CalibrationError for a camera whose focal length the views do not determine within 5 %."""
    for name, camera in zip(names, cameras, strict=True):
        fx, sigma = float(camera.K[0, 0]), float(camera.sigmas[0])
        if not (fx > 0 and sigma < _MAX_FOCAL_SIGMA * fx):
            raise CalibrationError(
                f"focal length {fx:.1f} px has a standard deviation of {sigma:.1f} px, limit "
                f"{100 * _MAX_FOCAL_SIGMA:g} %",
                subject=name,
                value=sigma,
                limit=_MAX_FOCAL_SIGMA * fx,
                remedy="tilt the board by 30 degrees about both axes in some of the views",
            )


def _check_baseline(T: F64) -> None:
    baseline_m = float(np.linalg.norm(T))
    if not MIN_BASELINE_M <= baseline_m <= MAX_BASELINE_M:
        raise CalibrationError(
            f"the calibrated baseline is {baseline_m:g} m, outside {MIN_BASELINE_M:g}..{MAX_BASELINE_M:g} m",
            value=baseline_m,
            limit=(MIN_BASELINE_M, MAX_BASELINE_M),
            remedy="enter the side of a square in meters: 25 mm is 0.025",
            settings=("square",),
        )
    if T[0] >= 0:
        raise CalibrationError(
            f"the right camera is {T[0]:g} m to the left of the left camera",
            value=float(T[0]),
            limit=0.0,
            remedy="exchange the left and right images",
            settings=("left", "right"),
        )


def row_errors_px(rig: StereoRig, view: BoardView) -> F64:
    """Row errors y_left - y_right of the corners that both cameras see, after rectification, float64 (N,) px."""
    _, at_left, at_right = np.intersect1d(view.left.ids, view.right.ids, return_indices=True)
    rows = [
        rectify_points(corners.image_px[at], camera)[:, 1]
        for camera, corners, at in ((rig.left, view.left, at_left), (rig.right, view.right, at_right))
    ]
    return rows[0] - rows[1]


def view_errors(solution: BundleSolution, views: Sequence[BoardView], rows: Sequence[F64]) -> Iterator[ViewErrors]:
    """The errors of each view of a solution of both cameras; ``rows`` are those of :func:`row_errors_px`."""
    errors = zip(solution.view_rms_px(0), solution.view_rms_px(1), rows, strict=True)
    for view, (left, right, row) in zip(views, errors, strict=True):
        rms_rows = float(np.sqrt(np.square(row).mean())) if row.size else float("nan")
        yield ViewErrors(view.name, view.left.image_px, view.right.image_px, float(left), float(right), rms_rows)


def _warnings(
    parameters: BundleParameters, cameras: Sequence[CalibratedCamera], size: tuple[int, int], circles: Circles
) -> Iterator[str]:
    if names := ", ".join(zeroed_coefficients(parameters)):
        yield f"the views do not determine {names}, fixed at 0: show the board near the edges of the image"
    sides = zip(("left", "right"), cameras, parameters.intrinsics, circles, strict=True)
    for side, camera, intrinsics, circle in sides:
        if camera.rms_px > _WARN_RATIO * camera.rms_alone_px:
            yield (
                f"{side} camera: rms {camera.rms_px:.2f} px with the other camera, {camera.rms_alone_px:.2f} px alone: "
                "the cameras are not synchronized, or the rig is not rigid; hold the board still"
            )
        range_px, corner_px = distortion_range_px(parameters.model, intrinsics, size)
        needed_px = needed_range_px(intrinsics, corner_px, circle)
        if range_px < needed_px:
            place = "image corners are" if circle is None else "edge of the image circle is"
            yield (
                f"{side} camera: the distortion decreases beyond {range_px:.0f} px from the principal point, the "
                f"{place} at {needed_px:.0f} px: show the board there, or use a model with fewer coefficients"
            )

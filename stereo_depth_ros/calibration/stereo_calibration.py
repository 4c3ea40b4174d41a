# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Both cameras and how they stand to each other, from views of a board."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np

from stereo_depth_ros.calibration.board_views import BoardView, Coverage, ViewCollector, placement
from stereo_depth_ros.calibration.bundle_adjustment import BundleAdjustment, Estimate, adjust_bundle
from stereo_depth_ros.calibration.calibration_result import SolvedCamera, StereoCalibration, ViewFigures
from stereo_depth_ros.calibration.camera_calibration import (
    MIN_LIMIT_PX,
    MIN_VIEWS,
    DroppedView,
    OneCamera,
    calibrate_camera,
    too_few,
    worst_view,
)
from stereo_depth_ros.calibration.distortion_range import check_edges, left_out, without_folding
from stereo_depth_ros.calibration.projection import camera_matrix, check_model, turning_radius_px
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import MAX_BASELINE_M, MIN_BASELINE_M, StereoRig
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.rays import rectify_points

__all__ = ["calibrate"]

MIN_DIFFERENT = 3  # as few as determine a pinhole
_MAX_FOCAL_SIGMA = 0.05  # of the focal length: above it the views do not tell the focal length
_TOGETHER = 2.0  # times the rms of a camera alone, above which the two images of a view disagree
_APART = 10.0  # times that rms, above which they are not images of one moment


def calibrate(views: Sequence[BoardView], model: str = "plumb_bob") -> StereoCalibration:
    """The rig from views of a board.

    Each camera is solved alone, then all parameters of both together, by least squares of the reprojection errors of
    all corners. A view that fits far less than the others do is dropped, the worst one first, and the rest solved
    again.

    Args:
        views: of one board, all of one size of images.
        model: "plumb_bob", "rational_polynomial" or "equidistant".

    Raises:
        ConfigError: an unknown model.
        CalibrationError: too few views agree, they do not determine the cameras, or the rig cannot be.
    """
    check_model(model)
    size = _common_size(views)
    _check_different(views)
    names = [view.name for view in views]
    left = calibrate_camera(names, [view.left for view in views], size, model, "left")
    right = calibrate_camera(names, [view.right for view in views], size, model, "right")
    kept = sorted(set(left.kept) & set(right.kept))
    dropped = [*left.dropped, *(view for view in right.dropped if view.name not in {one.name for one in left.dropped})]
    kept, start = _first_rig(left, right, kept, dropped)
    solution, kept = _solve(views, kept, start, dropped)
    alone_px = (left.solution.rms_px(), right.solution.rms_px())
    _check_together(solution, alone_px, len(kept), len(views))
    solution = without_folding([(views[number].left, views[number].right) for number in kept], solution, size)
    return _result(views, kept, dropped, solution, alone_px, size)


def _common_size(views: Sequence[BoardView]) -> tuple[int, int]:
    if len(views) < MIN_VIEWS:
        raise too_few(len(views), ())
    first = views[0]
    for view in views:
        if view.size != first.size:
            raise CalibrationError(
                f"{view.name} is {view.size[0]}x{view.size[1]}, {first.name} is {first.size[0]}x{first.size[1]}: "
                "a calibration is for one size of images, take all of them at the same resolution"
            )
    return first.size


def _check_different(views: Sequence[BoardView]) -> None:
    """Views that are one view over and over fit any camera."""
    collector = ViewCollector()
    different = sum([collector.add(view) for view in views])
    if different < MIN_DIFFERENT:
        raise CalibrationError(
            f"{different} of {len(views)} views differ, at least {MIN_DIFFERENT} are needed: tilt the board about both "
            "axes and take it to all parts of the image"
        )


def _first_rig(
    left: OneCamera, right: OneCamera, kept: list[int], dropped: list[DroppedView]
) -> tuple[list[int], Estimate]:
    """Where most views put the right camera, and both cameras as they are alone."""
    if len(kept) < MIN_VIEWS:
        raise too_few(len(kept), dropped)
    poses = [np.array([one.solution.estimate.poses[one.kept.index(n)] for n in kept]) for one in (left, right)]
    rigs = np.array([_relative_pose(*pair) for pair in zip(*poses, strict=True)])
    intrinsics = (left.solution.estimate.intrinsics[0], right.solution.estimate.intrinsics[0])
    return kept, Estimate(left.solution.estimate.model, intrinsics, np.median(rigs, axis=0), poses[0])


def _relative_pose(left: F64, right: F64) -> F64:
    """From the left to the right camera, of the poses of one board: rotation vector, translation."""
    R_left, R_right = cv2.Rodrigues(left[:3])[0], cv2.Rodrigues(right[:3])[0]
    R = R_right @ R_left.T
    return np.concatenate([cv2.Rodrigues(R)[0].ravel(), right[3:] - R @ left[3:]])


def _solve(
    views: Sequence[BoardView], kept: list[int], start: Estimate, dropped: list[DroppedView]
) -> tuple[BundleAdjustment, list[int]]:
    """All parameters together, without the views whose two images do not belong together."""
    while True:
        pairs = [(views[number].left, views[number].right) for number in kept]
        solution = adjust_bundle(pairs, start, robust=True)
        worst = worst_view(np.hypot(solution.view_rms_px(0), solution.view_rms_px(1)) / np.sqrt(2))
        if worst is None:
            return adjust_bundle(pairs, solution.estimate), kept
        at, reason = worst
        text = (
            f"left and right together: {reason}; each camera alone fits, so the board or the rig moved between the two"
        )
        dropped.append(DroppedView(views[kept[at]].name, text))
        kept = [number for number in kept if number != kept[at]]
        if len(kept) < MIN_VIEWS:
            raise too_few(len(kept), dropped)
        start = replace(solution.estimate, poses=np.delete(solution.estimate.poses, at, axis=0))


def _check_together(solution: BundleAdjustment, alone_px: tuple[float, float], used: int, count: int) -> None:
    for number, side in enumerate(("left", "right")):
        rms_px, alone = solution.rms_px(number), alone_px[number]
        if rms_px > _APART * max(alone, MIN_LIMIT_PX):
            raise CalibrationError(
                f"{used} of {count} views: {side} rms {rms_px:.2f} px with the other camera, {alone:.2f} px alone: the "
                "two images of a pair do not belong together, pair those that were taken at the same time by one rig"
            )


def _result(
    views: Sequence[BoardView],
    kept: list[int],
    dropped: list[DroppedView],
    solution: BundleAdjustment,
    alone_px: tuple[float, float],
    size: tuple[int, int],
) -> StereoCalibration:
    estimate = solution.estimate
    sigmas = solution.sigmas
    cameras = [_camera(solution, side, sigmas, alone_px[side]) for side in (0, 1)]
    _check_determined(cameras)
    R, T = cv2.Rodrigues(estimate.rig[:3])[0], estimate.rig[3:]
    _check_baseline(T)
    check_edges(estimate, size)
    left, right = cameras
    rig = StereoRig.from_calibration(left.K, left.D, right.K, right.D, R, T, size, estimate.model)
    used = [views[number] for number in kept]
    rows = [_row_errors_px(rig, view) for view in used]
    errors_px = np.concatenate(rows)
    if not errors_px.size:
        raise CalibrationError(
            "both cameras see no corner of the board in common in any view: hold it where both see the same part of it"
        )
    along = np.concatenate([np.zeros(len(sigmas) - 3), T / np.linalg.norm(T)])
    return StereoCalibration(
        model=estimate.model,
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
        views=tuple(_figures(solution, used, rows)),
        dropped=tuple(dropped),
        coverage=Coverage.of([placement(view.left, size) for view in used]),
        warnings=tuple(_warnings(estimate, cameras, size)),
    )


def _camera(solution: BundleAdjustment, side: int, sigmas: F64, alone_px: float) -> SolvedCamera:
    intrinsics = solution.estimate.intrinsics[side]
    own = sigmas[side * intrinsics.size : (side + 1) * intrinsics.size]
    return SolvedCamera(camera_matrix(intrinsics), intrinsics[4:], own, solution.rms_px(side), alone_px)


def _check_determined(cameras: Sequence[SolvedCamera]) -> None:
    for side, camera in zip(("left", "right"), cameras, strict=True):
        fx, sigma = float(camera.K[0, 0]), float(camera.sigmas[0])
        if not (fx > 0 and sigma < _MAX_FOCAL_SIGMA * fx):
            raise CalibrationError(
                f"{side} focal length {fx:.1f} px is known to {sigma:.1f} px only, limit "
                f"{100 * _MAX_FOCAL_SIGMA:g} %: tilt the board by 30 degrees about both axes in some of the views"
            )


def _check_baseline(T: F64) -> None:
    baseline_m = float(np.linalg.norm(T))
    if not MIN_BASELINE_M <= baseline_m <= MAX_BASELINE_M:
        raise CalibrationError(
            f"the cameras come out {baseline_m:g} m apart, outside {MIN_BASELINE_M:g}..{MAX_BASELINE_M:g} m: "
            "the side of a square is given in meters, 25 mm are 0.025"
        )
    if T[0] >= 0:
        raise CalibrationError(
            f"the right camera comes out {T[0]:g} m left of the left one: exchange the images of left and right"
        )


def _row_errors_px(rig: StereoRig, view: BoardView) -> F64:
    """Left row less right row of the corners that both cameras see, after rectification, px."""
    _, at_left, at_right = np.intersect1d(view.left.ids, view.right.ids, return_indices=True)
    rows = [
        rectify_points(corners.image_px[at], camera)[:, 1]
        for camera, corners, at in ((rig.left, view.left, at_left), (rig.right, view.right, at_right))
    ]
    return rows[0] - rows[1]


def _figures(solution: BundleAdjustment, views: Sequence[BoardView], rows: Sequence[F64]) -> Iterator[ViewFigures]:
    errors = zip(solution.view_rms_px(0), solution.view_rms_px(1), rows, strict=True)
    for view, (left, right, row) in zip(views, errors, strict=True):
        rms_rows = float(np.sqrt(np.square(row).mean())) if row.size else float("nan")
        yield ViewFigures(view.name, view.left.image_px, view.right.image_px, float(left), float(right), rms_rows)


def _warnings(estimate: Estimate, cameras: Sequence[SolvedCamera], size: tuple[int, int]) -> Iterator[str]:
    if names := ", ".join(left_out(estimate)):
        yield f"the views do not determine {names}, left 0: show the board near the edges of the image"
    for side, camera, intrinsics in zip(("left", "right"), cameras, estimate.intrinsics, strict=True):
        if camera.rms_px > _TOGETHER * camera.rms_alone_px:
            yield (
                f"{side}: rms {camera.rms_px:.2f} px with the other camera, {camera.rms_alone_px:.2f} px alone: the "
                "cameras do not expose at the same time, or the rig is not stiff; hold the board still"
            )
        turn_px, corner_px = turning_radius_px(estimate.model, intrinsics, size)
        if turn_px < corner_px:
            yield (
                f"{side}: beyond {turn_px:.0f} px from the center the distortion folds back (the image reaches to "
                f"{corner_px:.0f} px): show the board there, or take a model with fewer coefficients"
            )

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Geometry and calibration on real data, compared with OpenCV on the same corners and matches.

python benchmarks/calibration.py
python benchmarks/calibration.py --data ~/stereo --json calibration.json

Row errors are medians over features matched after rectification; those of uncalibrated rectification are over matches
that were not used to estimate the fundamental matrix. The fisheye boards and scene were not used for tuning.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.calibration.board_options import create_board
from stereo_depth_ros.calibration.board_views import BoardView
from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.misalignment import Misalignment, MisalignmentEstimator, corrected_rig
from stereo_depth_ros.calibration.row_error import match_rows
from stereo_depth_ros.calibration.stereo_calibration import calibrate
from stereo_depth_ros.calibration.view_finder import find_views
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, U8, StereoPair
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.datasets.stereo_images import open_stereo_images
from stereo_depth_ros.files.output import write_file
from stereo_depth_ros.geometry.calibrated_rectification import METHODS, rectify_calibrated
from stereo_depth_ros.geometry.correspondences import Correspondences, match_features
from stereo_depth_ros.geometry.epipolar import (
    camera_coordinates,
    fundamental_from_pose,
    sampson_distance,
    symmetric_epipolar_distance,
)
from stereo_depth_ros.geometry.essential import estimate_essential
from stereo_depth_ros.geometry.fundamental import estimate_fundamental
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.geometry.uncalibrated_rectification import rectify_uncalibrated, shape_under
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.stages.rectification import Rectifier

DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-12)
TURN_DEG = 0.3


class Row(NamedTuple):
    """One compared quantity."""

    data: str
    figure: str
    ours: str
    opencv: str
    required: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder of the datasets")
    parser.add_argument("--json", type=Path, help="write the rows as JSON")
    arguments = parser.parse_args()
    rows = []
    for part in (chessboards, fisheyes, calibrated_rectification, matrices, uncalibrated_rectification, monitoring):
        for row in part(arguments.data):
            print("| " + " | ".join(row) + " |", flush=True)
            rows.append(row._asdict())
    if arguments.json:
        write_file(arguments.json, json.dumps(rows, indent=2) + "\n", overwrite=True)


def chessboards(data: Path) -> Iterator[Row]:
    """The 13 chessboard pairs of the OpenCV samples."""
    views = board_views(data / "opencv_samples" / "chessboard_stereo")
    ours = calibrate(views)
    theirs = opencv_calibration(views, (640, 480))
    yield from calibration_rows("OpenCV boards", ours, theirs, ("<= 0.25", "<= 0.35", "83.2 +- 1"))
    focal = ", ".join(f"{camera.K[0, 0]:.1f}" for camera in (ours.left, ours.right))
    yield Row(
        "OpenCV boards", "focal lengths, px", focal, f"{theirs['f'][0]:.1f}, {theirs['f'][1]:.1f}", "534.8 +- 1 %"
    )
    yield Row("OpenCV boards", "row error of corners, rms px", f"{ours.epipolar_rms_px:.3f}", "", "<= 0.2")


def fisheyes(data: Path) -> Iterator[Row]:
    """The 10 chessboard pairs of StereoPi, and its scene, which has half the resolution."""
    folder = data / "stereopi" / "fisheye_v2"
    views = board_views(folder / "pairs")
    ours = calibrate(views, "equidistant")
    theirs = opencv_fisheye_calibration(views, (640, 480))
    yield from calibration_rows("StereoPi fisheye", ours, theirs, ("<= 0.35", "<= 0.35", "64.6 +- 2"))
    left, right = fisheye_scene(folder, ours.rig)
    yield Row(
        "StereoPi fisheye", "row error of the scene, px", f"{rows_of(match_features(left, right)):.3f}", "", "<= 0.4"
    )


def calibration_rows(
    name: str, ours: StereoCalibration, theirs: dict[str, Any], required: tuple[str, str, str]
) -> Iterator[Row]:
    reprojection = f"{ours.left.rms_px:.3f}, {ours.right.rms_px:.3f}"
    yield Row(
        name, "reprojection rms, px", reprojection, ", ".join(f"{rms:.3f}" for rms in theirs["sides"]), required[0]
    )
    yield Row(name, "stereo rms, px", f"{ours.rms_stereo_px:.3f}", f"{theirs['rms']:.3f}", required[1])
    sigma = f"{1e3 * ours.baseline_m:.2f} +- {1e3 * ours.baseline_sigma_m:.2f}"
    yield Row(name, "baseline, mm", sigma, f"{1e3 * theirs['baseline']:.2f}", required[2])


def calibrated_rectification(data: Path) -> Iterator[Row]:
    """EuRoC with the published calibration."""
    dataset = EurocDataset(data / "euroc" / "V1_01_micro")
    frames = list(dataset)[::3]
    raw = [match_features(frame.left.pixels, frame.right.pixels) for frame in frames]
    after = []
    for method in METHODS:
        rig = rectify_calibrated(dataset.rig.left, dataset.rig.right, RelativePose.from_rig(dataset.rig), method=method)
        rectifier = Rectifier(rig)
        pairs = [rectifier.rectify(StereoPair(frame.left, frame.right)) for frame in frames]
        after.append(rows_of(*(match_features(pair.left, pair.right) for pair in pairs)))
    yield Row("EuRoC", "row error raw, px", f"{rows_of(*raw):.2f}", "", "12.8")
    yield Row("EuRoC", "row error rectified, px", f"{after[0]:.3f}", f"{after[1]:.3f}", "<= 0.15")


def matrices(data: Path) -> Iterator[Row]:
    """EuRoC from matches only; median and maximum over all pairs."""
    dataset = EurocDataset(data / "euroc" / "V1_01_micro")
    left, right = dataset.rig.left, dataset.rig.right
    published = RelativePose.from_rig(dataset.rig)
    F = fundamental_from_pose(published, left.K, right.K)
    figures: list[list[float]] = []
    for frame in dataset:
        matches = match_features(frame.left.pixels, frame.right.pixels).undistorted(left, right)
        a, b = matches.left_px, matches.right_px
        fit = symmetric_epipolar_distance(F, a, b) < 1
        found = [estimate_fundamental(a, b).F, cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, 1.0, 0.999, 8192)[0]]
        poses = [estimate_essential(a, b, left.K, right.K).pose, opencv_pose(a, b, left.K, right.K)]
        figures.append([float(symmetric_epipolar_distance(each, a[fit], b[fit]).mean()) for each in found])
        figures[-1] += [float(np.degrees(pose.rotation_angle_to(published))) for pose in poses]
        figures[-1] += [float(np.degrees(pose.direction_angle_to(published))) for pose in poses]
    middle, worst = np.median(figures, axis=0), np.max(figures, axis=0)
    names = ("F: symmetric distance, px", "E: rotation, deg", "E: direction of t, deg")
    for number, (name, limit) in enumerate(zip(names, ("<= 0.5", "<= 0.5", "<= 3"), strict=True)):
        ours, theirs = (f"{middle[at]:.3f} (worst {worst[at]:.3f})" for at in (2 * number, 2 * number + 1))
        yield Row("EuRoC", name, ours, theirs, limit)


def uncalibrated_rectification(data: Path) -> Iterator[Row]:
    """Rectification from F only, after the removal of distortion."""
    dataset = EurocDataset(data / "euroc" / "V1_01_micro")
    frame = next(iter(dataset))
    raw = match_features(frame.left.pixels, frame.right.pixels)
    yield from uncalibrated_rows("EuRoC", raw.undistorted(dataset.rig.left, dataset.rig.right), (752, 480))
    folder = data / "stereopi" / "fisheye_v2"
    rig = calibrate(board_views(folder / "pairs"), "equidistant").rig
    raw = match_features(*raw_scene(folder))
    yield from uncalibrated_rows("StereoPi scene", raw.undistorted(rig.left, rig.right), (640, 480))


def uncalibrated_rows(name: str, matches: Correspondences, size: tuple[int, int]) -> Iterator[Row]:
    order = np.random.default_rng(0).permutation(len(matches))
    fitted, held = matches.take(order[::2]), matches.take(order[1::2])
    estimate = estimate_fundamental(fitted.left_px, fitted.right_px)
    held = held.take(sampson_distance(estimate.F, held.left_px, held.right_px) < 3)
    found = rectify_uncalibrated(estimate.F, size)
    inliers = fitted.take(estimate.inliers)
    _, H_left, H_right = cv2.stereoRectifyUncalibrated(inliers.left_px, inliers.right_px, estimate.F, size)
    errors, shapes = [], []
    for homographies in ((found.H_left, found.H_right), (H_left, H_right)):
        y = [
            cv2.perspectiveTransform(points[:, None], H)[:, 0, 1]
            for points, H in zip((held.left_px, held.right_px), homographies, strict=True)
        ]
        errors.append(f"{np.median(np.abs(y[0] - y[1])):.3f}")
        worst = max((shape_under(H, size) for H in homographies), key=lambda shape: abs(shape.angle_deg - 90))
        shapes.append(f"{worst.angle_deg:.2f}, {worst.aspect:.4f}")
    yield Row(name, "row error from F only, px", errors[0], errors[1], "<= 0.5")
    yield Row(name, "midlines: angle in deg, aspect", shapes[0], shapes[1], "90, 1")


def monitoring(data: Path) -> Iterator[Row]:
    """KITTI: the second half with rotated right images, compared with the unchanged first half."""
    dataset = KittiDataset(data / "kitti_odometry" / "seqA_1226x370")
    pairs = [(frame.left.pixels, frame.right.pixels) for frame in dataset]
    undisturbed = follow(dataset.rig, pairs[:10], None)[-1]
    reference_deg, pairs = float(undisturbed.rotation_deg[1]), pairs[10:]
    angles = ", ".join(f"{value:+.3f}" for value in undisturbed.rotation_deg)
    density, rows_px = quality(dataset.rig, pairs)
    yield Row("KITTI", "undisturbed: pitch, yaw, roll, deg", angles, "", "")
    yield Row("KITTI", "undisturbed: density, row error", f"{100 * density:.1f} %, {rows_px:.3f} px", "", "")
    K = dataset.rig.right.P[:, :3]
    for axis, (name, limit) in enumerate(zip("xyz", ("0.03", "0.1", "0.03"), strict=True)):
        w = np.zeros(3)
        w[axis] = np.radians(TURN_DEG)
        H = K @ cv2.Rodrigues(w)[0] @ np.linalg.inv(K)
        turned = [
            (left, np.asarray(cv2.warpPerspective(right, H, left.shape[::-1]), np.uint8)) for left, right in pairs
        ]
        found = follow(dataset.rig, turned, reference_deg)
        at = next(index for index, each in enumerate(found) if each.detected) + 3
        error = found[-1].rotation_deg[axis] - undisturbed.rotation_deg[axis] - TURN_DEG
        off = quality(dataset.rig, turned)
        again = quality(corrected_rig(dataset.rig, found[-1], reference_yaw_deg=reference_deg), turned)
        figure = f"right camera rotated by {TURN_DEG} deg about {name}"
        estimated = f"{error:+.4f} +- {found[-1].rotation_sigma_deg[axis]:.4f} deg off, pair {at}"
        yield Row("KITTI", figure, estimated, "", f"{limit} deg, 20 pairs")
        figures = " -> ".join(f"{100 * d:.1f} %, {e:.3f} px" for d, e in (off, again))
        yield Row("KITTI", "disturbed -> corrected", figures, "", "within 5 %")


def follow(rig: StereoRig, pairs: list[tuple[U8, U8]], reference_deg: float | None) -> list[Misalignment]:
    estimator = MisalignmentEstimator(rig, reference_deg)
    return [found for pair in pairs if (found := estimator.add(match_rows(*pair))) is not None]


def quality(rig: StereoRig, pairs: list[tuple[U8, U8]]) -> tuple[float, float]:
    """Density of the disparities and median row error if the rig rectifies the right images."""
    rectifier, matcher = Rectifier(rig), create_matcher("sgm", num_disparities=128)
    straight = [(left, rectifier.rectify_right(right)) for left, right in pairs[::2]]
    densities = [np.isfinite(matcher.match(*pair).disparity_px).mean() for pair in straight]
    errors = np.concatenate([match_rows(*pair).errors_px for pair in straight])
    return float(np.mean(densities)), float(np.median(np.abs(errors)))


def board_views(folder: Path) -> list[BoardView]:
    """Views of a chessboard of 9x6 corners, 25 mm."""
    return find_views(
        open_stereo_images(folder),
        create_board("chessboard", (9, 6), 0.025),
        lambda size: create_board("chessboard", size, 1),
    ).views


def raw_scene(folder: Path) -> tuple[U8, U8]:
    """The scene of StereoPi, scaled to the resolution of its boards."""
    scene = cv2.imread(str(folder / "scenes" / "photo.png"), cv2.IMREAD_GRAYSCALE)
    large = np.asarray(cv2.resize(scene, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC), np.uint8)
    return np.ascontiguousarray(large[:, :640]), np.ascontiguousarray(large[:, 640:])


def fisheye_scene(folder: Path, rig: StereoRig) -> tuple[U8, U8]:
    """The rectified scene of StereoPi."""
    rectifier = Rectifier(rig)
    left, right = raw_scene(folder)
    return rectifier.rectify_left(left), rectifier.rectify_right(right)


def rows_of(*matches: Correspondences) -> float:
    """Median row error, px."""
    return float(np.median(np.abs(np.concatenate([each.left_px[:, 1] - each.right_px[:, 1] for each in matches]))))


def opencv_calibration(views: list[BoardView], size: tuple[int, int]) -> dict[str, Any]:
    board = [view.left.board_m.astype(np.float32) for view in views]
    sides = [[getattr(view, side).image_px.astype(np.float32) for view in views] for side in ("left", "right")]
    alone: list[Any] = [cv2.calibrateCamera(board, side, size, None, None) for side in sides]
    flags = cv2.CALIB_USE_INTRINSIC_GUESS
    solve: Any = cv2.stereoCalibrate
    rms, K, _, K_right, _, _, T, *_ = solve(
        board, *sides, *alone[0][1:3], *alone[1][1:3], size, flags=flags, criteria=CRITERIA
    )
    f = K[0, 0], K_right[0, 0]
    return {"rms": rms, "sides": [each[0] for each in alone], "baseline": float(np.linalg.norm(T)), "f": f}


def opencv_fisheye_calibration(views: list[BoardView], size: tuple[int, int]) -> dict[str, Any]:
    board = [view.left.board_m[None] for view in views]
    sides = [[getattr(view, side).image_px[None] for view in views] for side in ("left", "right")]
    names = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2  # OpenCV 4, OpenCV 5
    flags = names.CALIB_RECOMPUTE_EXTRINSIC + names.CALIB_FIX_SKEW
    solve: Any = cv2.fisheye.stereoCalibrate
    alone: list[Any] = [
        cv2.fisheye.calibrate(board, side, size, None, None, flags=flags, criteria=CRITERIA) for side in sides
    ]
    rms, *_, T = solve(
        board, *sides, *alone[0][1:3], *alone[1][1:3], size, flags=names.CALIB_FIX_SKEW, criteria=CRITERIA
    )[:7]
    return {"rms": rms, "sides": [each[0] for each in alone], "baseline": float(np.linalg.norm(T))}


def opencv_pose(left_px: F64, right_px: F64, K_left: F64, K_right: F64) -> RelativePose:
    left, right = camera_coordinates(left_px, K_left), camera_coordinates(right_px, K_right)
    E, inliers = cv2.findEssentialMat(left, right, np.identity(3), cv2.USAC_MAGSAC, 0.999, 1 / K_left[0, 0])
    _, R, t, _ = cv2.recoverPose(E, left, right, np.identity(3), mask=inliers)
    return RelativePose(R, t, up_to_scale=True)


if __name__ == "__main__":
    main()

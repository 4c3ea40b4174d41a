# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a projector and its camera from corners of boards that are known exactly, and from real captures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from known_projector import ABOVE, BESIDE, BOARD_M, PLACES, KnownProjector, poses, views

from stereo_depth_ros.active.projector.board_points import board_in_projector
from stereo_depth_ros.active.projector.calibration import calibrate_projector
from stereo_depth_ros.active.projector.raster import resized_camera, resized_points
from stereo_depth_ros.active.projector.resection import resect
from stereo_depth_ros.active.projector.result import ProjectorCalibration
from stereo_depth_ros.active.structured_light.decoding import decode
from stereo_depth_ros.active.structured_light.patterns import Pattern, PatternSequence
from stereo_depth_ros.calibration.board_views import BoardView
from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.camera_calibration import initial_pose
from stereo_depth_ros.calibration.chessboard import Chessboard
from stereo_depth_ros.calibration.projection import camera_matrix, project
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, ConfigError, ImageError
from stereo_depth_ros.core.types import F64

NOISE_PX = (0.05, 0.1)  # of corners in the camera, and in the projector


def intrinsics(found: ProjectorCalibration) -> tuple[F64, F64]:
    """fx, fy, cx, cy of the camera and of the projector, in their own pixels."""
    camera, projector = (each.K[[0, 1, 0, 1], [0, 1, 2, 2]] for each in (found.stereo.left, found.stereo.right))
    return camera, projector


@pytest.mark.parametrize("place", PLACES)
def test_exact_corners_give_camera_projector_and_pose(place: str) -> None:
    known = PLACES[place]
    found = calibrate_projector(views(known, 7), known.projector_size)
    camera, projector = intrinsics(found)
    np.testing.assert_allclose(camera, known.camera[:4], atol=1e-4)
    np.testing.assert_allclose(projector, known.projector[:4], atol=1e-4)
    np.testing.assert_allclose(found.stereo.right.D, known.projector[4:], atol=1e-5)
    np.testing.assert_allclose(found.stereo.T, known.rig[3:], atol=1e-6)
    np.testing.assert_allclose(found.stereo.R, known.pose.R, atol=1e-6)
    assert found.zero_coefficients == ("k2", "p1", "p2", "k3")
    assert found.stereo.epipolar_rms_px < 1e-3
    assert not found.stereo.dropped and not found.stereo.warnings


@pytest.mark.parametrize(
    ("coefficients", "zero"), [((0.0, 0.0), ("k1", "k2", "p1", "p2", "k3")), ((-0.06, 0.0), ("k2", "p1", "p2", "k3"))]
)
def test_coefficients_that_predict_no_pose_are_zero(coefficients: tuple[float, float], zero: tuple[str, ...]) -> None:
    known = replace(BESIDE, projector=np.array([*BESIDE.projector[:4], *coefficients, 0, 0, 0]))
    for seed in range(3):
        found = calibrate_projector(views(known, 7, NOISE_PX, seed), known.projector_size)
        assert found.zero_coefficients == zero


def test_two_poses_of_a_distorted_projector_with_a_known_camera() -> None:
    known = replace(BESIDE, projector=np.array([*BESIDE.projector[:4], -0.15, 0, 0, 0, 0]))
    found = calibrate_projector(views(known, 2, NOISE_PX), known.projector_size, camera=known.models[0])
    assert found.zero_coefficients == ("k2", "p1", "p2", "k3")
    errors = np.abs(intrinsics(found)[1] - known.projector[:4])
    assert (errors < 4 * found.stereo.right.sigmas[:4]).all()


def test_errors_are_those_of_the_standard_deviations() -> None:
    draws = [calibrate_projector(views(BESIDE, 7, NOISE_PX, seed), BESIDE.projector_size).stereo for seed in range(6)]
    true = np.array([*BESIDE.projector[:4], *BESIDE.rig[3:]])
    found = np.array([[*d.right.K[[0, 1, 0, 1], [0, 1, 2, 2]], *d.T] for d in draws])
    sigmas = np.array([[*d.right.sigmas[:4], *d.T_sigma_m] for d in draws])
    share = np.sqrt(np.mean(np.square((found - true) / sigmas), axis=0))
    # Of 6 draws the root mean square is known to 30 %; the sigmas are the larger of two estimates
    assert (share > 0.2).all() and (share < 1.6).all()
    assert np.mean([d.right.rms_px for d in draws]) == pytest.approx(NOISE_PX[1] * np.sqrt(2), rel=0.1)
    assert np.mean([d.left.rms_px for d in draws]) == pytest.approx(NOISE_PX[0] * np.sqrt(2), rel=0.1)


def test_the_rig_is_that_of_the_resized_pattern() -> None:
    """A pixel of the pattern keeps its place when the pattern is resized to the size of the camera image."""
    found = calibrate_projector(views(BESIDE, 7), BESIDE.projector_size)
    right = found.stereo.rig.right
    assert (right.width, right.height) == BESIDE.camera_size
    fine = np.zeros((300, 400), np.uint8)
    fine[100:120, 200:240] = 255
    moments = cv2.moments(cv2.resize(fine, BESIDE.camera_size, interpolation=cv2.INTER_AREA))
    center = np.array([[moments["m10"], moments["m01"]]]) / moments["m00"]
    np.testing.assert_allclose(resized_points(np.array([[219.5, 109.5]]), (400, 300), (320, 240)), center, atol=0.01)
    points = np.array([[0.05, -0.1, 0.9], [-0.1, 0.02, 0.7]])
    stored = resized_camera(BESIDE.models[1], BESIDE.camera_size)
    np.testing.assert_allclose(stored.K, right.K, atol=1e-3)
    pixels = cv2.projectPoints(points, BESIDE.rig[:3], BESIDE.rig[3:], right.K, right.D)[0][:, 0]
    expected = resized_points(BESIDE.in_projector(points), (400, 300), (320, 240))
    np.testing.assert_allclose(pixels, expected, atol=1e-3)


def test_a_known_camera_and_two_poses() -> None:
    """The camera stays as it is; what two poses do not determine is 0 and said."""
    known = replace(BESIDE, projector=np.array([470.0, 463.0, 190.0, 310.0, 0, 0, 0, 0, 0]))
    found = calibrate_projector(views(known, 2), known.projector_size, camera=known.models[0])
    camera, projector = intrinsics(found)
    np.testing.assert_array_equal(camera, known.camera[:4])
    np.testing.assert_allclose(projector, known.projector[:4], atol=1e-3)
    np.testing.assert_allclose(found.stereo.T, known.rig[3:], atol=1e-5)
    assert found.camera_known and not found.stereo.left.sigmas.any()
    assert found.zero_coefficients == ("k1", "k2", "p1", "p2", "k3")
    assert any("2 poses: the standard deviations are those of the corners alone" in w for w in found.stereo.warnings)


def test_three_poses_without_a_camera() -> None:
    known = replace(BESIDE, camera=np.array([301.0, 304.0, 165.0, 114.0, -0.12, 0.05, 0, 0, 0]))
    found = calibrate_projector(views(known, 3, seed=4), known.projector_size)
    np.testing.assert_allclose(intrinsics(found)[1], known.projector[:4], rtol=1e-3)
    assert found.stereo.left.D[4] == 0  # k3 is not determined
    assert any("do not determine k3 of the camera" in w for w in found.stereo.warnings)


def moved(view: BoardView, right_px: F64) -> BoardView:
    return replace(view, right=replace(view.right, image_px=view.right.image_px + right_px))


def test_poses_that_do_not_fit_are_dropped_and_named() -> None:
    """A pose with wrong codes, one in which the projector had moved, and one of which it lights too little."""
    seen = views(BESIDE, 9, NOISE_PX)
    wrong = np.random.default_rng(3).uniform(-150, 150, seen[2].right.image_px.shape)
    seen[2] = moved(seen[2], wrong)
    seen[5] = moved(seen[5], np.array([3.0, -2.0]) * np.linspace(-1, 1, len(BOARD_M))[:, None])
    few = seen[7].right
    seen[7] = replace(seen[7], right=Corners(few.ids[:6], few.board_m[:6], few.image_px[:6]))
    found = calibrate_projector(seen, BESIDE.projector_size)
    reasons = {view.name: view.reason for view in found.stereo.dropped}
    assert [*reasons] == ["pose07", "pose02", "pose05"]
    assert "projector: 6 of 35 corners are surrounded by decoded pixels, 8 are needed" in reasons["pose07"]
    assert "projector: median error" in reasons["pose02"] and "its code is wrong" in reasons["pose02"]
    assert "camera and projector: reprojection rms" in reasons["pose05"]
    assert len(found.stereo.views) == 6
    np.testing.assert_allclose(found.stereo.T, BESIDE.rig[3:], atol=0.02)


def test_corners_that_the_projector_does_not_light_are_missing_in_it_only() -> None:
    seen = views(BESIDE, 7)
    for number in (1, 4):
        right = seen[number].right
        kept = right.ids % 3 != 0
        some = Corners(right.ids[kept], right.board_m[kept], right.image_px[kept])
        seen[number] = replace(seen[number], right=some)
    found = calibrate_projector(seen, BESIDE.projector_size)
    np.testing.assert_allclose(intrinsics(found)[1], BESIDE.projector[:4], atol=1e-3)


def test_too_little_for_a_calibration() -> None:
    seen = views(BESIDE, 7)
    size, camera = BESIDE.projector_size, BESIDE.models[0]
    with pytest.raises(CalibrationError, match="1 pose of the board, at least 3 are required for camera and projector"):
        calibrate_projector(seen[:1], size)
    with pytest.raises(CalibrationError, match=r"2 poses .* or give the calibration of the camera"):
        calibrate_projector(seen[:2], size)
    with pytest.raises(
        CalibrationError, match=r"1 pose .* at least 2 are required for a projector with a known camera"
    ):
        calibrate_projector(seen[:1], size, camera=camera)
    with pytest.raises(CalibrationError, match=r"nearly one plane .* does not determine the projector: tilt the board"):
        calibrate_projector([seen[0], replace(seen[0], name="again")], size, camera=camera)
    with pytest.raises(CalibrationError, match="the camera is calibrated for 400x300, the images are 320x240"):
        calibrate_projector(seen, size, camera=BESIDE.models[1])
    with pytest.raises(ConfigError, match="'equidistant' is not one of plumb_bob, rational_polynomial"):
        calibrate_projector(seen, size, "equidistant")
    with pytest.raises(CalibrationError, match="pose01: image size 320x200, pose00 is 320x240"):
        calibrate_projector([seen[0], replace(seen[1], size=(320, 200)), *seen[2:]], size)
    large = [
        replace(
            view,
            left=replace(view.left, board_m=1000 * view.left.board_m),
            right=replace(view.right, board_m=1000 * view.right.board_m),
        )
        for view in seen
    ]
    with pytest.raises(
        CalibrationError, match=r"distance of camera and projector is 2\d\d.* m, outside .* 25 mm is 0.025"
    ):
        calibrate_projector(large, size)


@pytest.mark.parametrize(("cell_px", "limit_px"), [(1, 0.08), (4, 0.35)])
def test_local_homographies_give_corners_between_the_codes(cell_px: int, limit_px: float) -> None:
    """Among codes of whole projector cells, of which 5 % are wrong, around corners in a distorted image."""
    (pose,) = poses(BESIDE, 1, seed=2)
    exact = project("plumb_bob", BESIDE.camera, pose, BOARD_M).image_px
    corners = Corners(np.arange(len(BOARD_M)), BOARD_M, exact)
    found = board_in_projector(corners, BESIDE.board_map(pose, cell_px))
    expected = BESIDE.in_projector(BOARD_M @ cv2.Rodrigues(pose[:3])[0].T + pose[3:])
    assert len(found.ids) == len(BOARD_M)
    errors = np.linalg.norm(found.image_px - expected[found.ids], axis=1)
    assert np.sqrt(np.square(errors).mean()) < limit_px


def test_corners_without_decoded_pixels_around_them_are_left_out() -> None:
    (pose,) = poses(BESIDE, 1, seed=2)
    exact = project("plumb_bob", BESIDE.camera, pose, BOARD_M).image_px
    corners, seen = Corners(np.arange(len(BOARD_M)), BOARD_M, exact), BESIDE.board_map(pose)
    edge = int(exact[3, 0]) + 1  # the light ends between the columns of the board
    reasons = seen.reasons.copy()
    reasons[:, :edge] |= 128
    found = board_in_projector(corners, replace(seen, reasons=reasons))
    np.testing.assert_array_equal(found.ids, corners.ids[exact[:, 0] > edge])
    with pytest.raises(
        ImageError, match="the patterns do not code rows, a projector is calibrated by columns and rows"
    ):
        board_in_projector(corners, replace(seen, row_px=None))


def test_resection_is_exact_and_decomposes() -> None:
    known: KnownProjector = ABOVE
    random = np.random.default_rng(0)
    points = random.uniform([-0.3, -0.2, 0.6], [0.3, 0.2, 1.2], (12, 3))
    pinhole = np.array([*known.projector[:4], 0, 0, 0, 0, 0])
    found = resect(points, project("plumb_bob", pinhole, known.rig, points).image_px)
    K, R, T = found.decomposed()
    np.testing.assert_allclose(K[[0, 1, 0, 1], [0, 1, 2, 2]], pinhole[:4], rtol=1e-8)
    np.testing.assert_allclose(R, known.pose.R, atol=1e-9)
    np.testing.assert_allclose(T, known.rig[3:], atol=1e-9)
    assert found.rms_px < 1e-8
    with pytest.raises(CalibrationError, match="5 points do not determine the projector, at least 6"):
        resect(points[:5], points[:5, :2])


def board_captures(data: Path) -> tuple[PatternSequence, list[Path], F64]:
    """Sequence, folders and intrinsics of the camera of a board under the coarse bits of a Gray code, direct images."""
    folder = data / "active" / "a_procam_board_kamino_2poses"
    gray = [Pattern("gray", axis, bit) for axis in ("columns", "rows") for bit in range(9, 1, -1)]
    sequence = PatternSequence((1024, 768), (*gray, Pattern("white"), Pattern("black")))
    file = cv2.FileStorage(str(folder / "published_calibration_result.xml"), cv2.FILE_STORAGE_READ)
    K, D = (file.getNode(name).mat() for name in ("cam_int", "cam_dist"))
    return sequence, sorted(folder.glob("capture_*")), np.array([*K[[0, 1, 0, 1], [0, 1, 2, 2]], *D.ravel()])


@pytest.mark.real_data
def test_a_real_projector_by_two_poses(stereo_data: Path) -> None:
    sequence, folders, camera = board_captures(stereo_data)
    assert len(folders) == 2
    points, pixels, seen = [], [], []
    for folder in folders:
        images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(folder.glob("*.png"))]
        corners = Chessboard((9, 7), 0.075).detect(images[-2])
        assert corners is not None
        start = corners.image_px.min(axis=0).astype(int) - 50  # what is around the board is not decoded
        x, y = (
            slice(low, high + 100) for low, high in zip(start, corners.image_px.max(axis=0).astype(int), strict=True)
        )
        near = replace(corners, image_px=corners.image_px - start)
        found = board_in_projector(near, decode(sequence, [image[y, x] for image in images]))
        pose, _ = initial_pose("plumb_bob", camera, corners)
        points.append(found.board_m @ cv2.Rodrigues(pose[:3])[0].T + pose[3:])
        pixels.append(found.image_px)
        seen.append(BoardView(folder.name, (1280, 1024), corners, found))
    assert sum(map(len, pixels)) == 126
    assert resect(np.concatenate(points), np.concatenate(pixels)).rms_px <= 0.31
    bare = np.identity(4)[:3]
    model = CameraModel(1280, 1024, "plumb_bob", camera_matrix(camera), camera[4:], np.identity(3), bare)
    calibrated = calibrate_projector(seen, (1024, 768), camera=model)
    assert calibrated.stereo.right.rms_px <= 0.31
    assert calibrated.stereo.epipolar_rms_px < 0.15
    # values of all poses of the same setup, with another calibration of the camera
    np.testing.assert_allclose(np.diag(calibrated.stereo.right.K)[:2], [1891, 1896], rtol=0.01)
    assert calibrated.stereo.baseline_m == pytest.approx(0.675, abs=0.01)

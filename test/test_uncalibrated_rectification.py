# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectification from the fundamental matrix: rows, shape, distortion, OpenCV, the pipeline, real pairs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from two_views import F_TRUE, K_LEFT, K_RIGHT, POSE, SIZE, views

from stereo_depth_ros.calibration.board_options import create_board
from stereo_depth_ros.calibration.stereo_calibration import calibrate
from stereo_depth_ros.calibration.view_finder import find_views
from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64, U8, Frame, StereoPair
from stereo_depth_ros.core.uncalibrated_rig import UncalibratedRig
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.stereo_images import open_stereo_images
from stereo_depth_ros.geometry.correspondences import Correspondences, match_features
from stereo_depth_ros.geometry.epipolar import fundamental_from_pose, sampson_distance
from stereo_depth_ros.geometry.fundamental import estimate_fundamental
from stereo_depth_ros.geometry.rays import rectify_points
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.geometry.uncalibrated_rectification import (
    UncalibratedRectification,
    rectify_uncalibrated,
    shape_under,
)
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.stages.rectification import Rectifier

RECTIFIED = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
FOUND = rectify_uncalibrated(F_TRUE, SIZE)


def test_rows_agree() -> None:
    seen = views(60)
    left, right = FOUND.rectified(seen.left_px, seen.right_px)
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    assert np.ptp(left[:, 0] - right[:, 0]) > 20
    moved = np.linalg.inv(FOUND.H_right).T @ F_TRUE @ np.linalg.inv(FOUND.H_left)
    np.testing.assert_allclose(moved / moved[2, 1], RECTIFIED, atol=1e-9)


def test_disparity_grows_with_nearness() -> None:
    """For points on one ray; otherwise matchers would search in the wrong direction."""
    ray = np.array([[0.1, -0.05, 1.0]])
    points = ray * np.linspace(2, 8, 9)[:, None]
    left, right = points @ K_LEFT.T, (points @ POSE.R.T + POSE.t) @ K_RIGHT.T
    at_left, at_right = FOUND.rectified(left[:, :2] / left[:, 2:], right[:, :2] / right[:, 2:])
    assert (np.diff(at_left[:, 0] - at_right[:, 0]) < 0).all()


def test_shape_is_kept() -> None:
    """The midlines keep their right angle and the ratio of their lengths: no shear remains."""
    for shape in (FOUND.shape_left, FOUND.shape_right):
        assert shape.angle_deg == pytest.approx(90, abs=1e-6)
        assert shape.aspect == pytest.approx(1, abs=1e-6)
    for H in (FOUND.H_left, FOUND.H_right):
        assert np.linalg.det(H) > 0  # not mirrored


def test_area_and_center_are_kept() -> None:
    outlines = []
    for H in (FOUND.H_left, FOUND.H_right):
        corners = np.array([[[0.0, 0], [SIZE[0], 0], SIZE, [0, SIZE[1]]]]) - 0.5
        outlines.append(cv2.perspectiveTransform(corners, H)[0])
    area = sum(cv2.contourArea(outline.astype(np.float32)) for outline in outlines)
    assert area == pytest.approx(2 * SIZE[0] * SIZE[1], rel=1e-4)
    for outline in outlines:
        assert (outline[:, 0].min() + outline[:, 0].max()) / 2 == pytest.approx((SIZE[0] - 1) / 2)


def test_no_direction_has_less_distortion() -> None:
    """Against the sums of equation 10 over all pixels, for many directions."""
    offset = np.array([[1, 0, (SIZE[0] - 1) / 2], [0, 1, (SIZE[1] - 1) / 2], [0, 0, 1]])
    centred = offset.T @ F_TRUE @ offset
    x, y = np.meshgrid(np.arange(SIZE[0]) - (SIZE[0] - 1) / 2, np.arange(SIZE[1]) - (SIZE[1] - 1) / 2)
    epipole = np.linalg.svd(centred)[2][2]

    def distortion(angle: float) -> float:
        z = np.array([np.cos(angle), np.sin(angle), 0])
        lines = np.cross(epipole, z), centred @ z
        return float(sum(np.mean((a * x + b * y) ** 2) / c**2 for a, b, c in lines))

    assert FOUND.distortion <= min(distortion(angle) for angle in np.linspace(0, np.pi, 60)) + 1e-9
    weights = FOUND.H_left[2]
    own = np.mean(((weights[0] * x + weights[1] * y) / (weights @ [*offset[:2, 2], 1])) ** 2)
    assert own < FOUND.distortion


def test_a_rectified_pair_does_not_change() -> None:
    found = rectify_uncalibrated(RECTIFIED, SIZE)
    for H in (found.H_left, found.H_right):
        np.testing.assert_allclose(H, np.identity(3), atol=1e-4)
    assert found.distortion < 1e-12


def test_images_of_two_sizes() -> None:
    seen = views(40)
    found = rectify_uncalibrated(F_TRUE, SIZE, (700, 520))
    left, right = found.rectified(seen.left_px, seen.right_px)
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    assert found.size == SIZE


def test_shape_of_a_shear() -> None:
    shape = shape_under(np.array([[1, np.tan(np.radians(10)), 0], [0, 1, 0], [0, 0, 1]]), (400, 300))
    assert shape.angle_deg == pytest.approx(80)
    assert shape.aspect == pytest.approx(np.cos(np.radians(10)))


@pytest.mark.parametrize("t", [[0.02, 0.01, 0.3], [-0.3, 0.0, -0.6]])
def test_epipoles_in_the_image(t: list[float]) -> None:
    F = fundamental_from_pose(RelativePose(np.identity(3), np.array(t)), K_LEFT, K_RIGHT)
    with pytest.raises(CalibrationError, match=r"epipole is at \(.*\) px, in the image of 740x480.*move the camera"):
        rectify_uncalibrated(F, SIZE)


def test_epipoles_near_the_image() -> None:
    F = fundamental_from_pose(RelativePose(np.identity(3), np.array([-0.3, 0.0, 0.3])), K_LEFT, K_LEFT)
    with pytest.raises(CalibrationError, match=r"image: magnification would vary .* times between corners, limit 4"):
        rectify_uncalibrated(F, SIZE)


def test_not_a_fundamental_matrix() -> None:
    for matrix in (np.identity(3), np.zeros((3, 3)), np.full((3, 3), np.nan), np.ones((2, 2)), np.ones((3, 3))):
        with pytest.raises(CalibrationError, match="not those of a fundamental matrix, which has rank 2"):
            rectify_uncalibrated(matrix, SIZE)


def noise_pair() -> tuple[U8, U8]:
    """A texture and itself, tilted and shifted: a plane seen by two cameras."""
    random = np.random.default_rng(0)
    texture = cv2.resize(random.integers(0, 255, (160, 240), np.uint8), (480, 320), interpolation=cv2.INTER_CUBIC)
    return texture, texture


def test_rectification_in_the_pipeline() -> None:
    """A pair whose right image is lower and rotated: the pipeline rectifies it and finds the given disparity."""
    left, _ = noise_pair()
    turn = cv2.Rodrigues(np.array([0.004, 0.0, 0.03]))[0]
    K = np.array([[400.0, 0, 239.5], [0, 400, 159.5], [0, 0, 1]])
    tilt = K @ turn @ np.linalg.inv(K) @ np.array([[1.0, 0, -11], [0, 1, 0], [0, 0, 1]])
    right = np.asarray(cv2.warpPerspective(left, tilt, (480, 320), flags=cv2.INTER_CUBIC), np.uint8)
    rig = UncalibratedRig.from_homographies(np.identity(3), np.linalg.inv(K @ turn @ np.linalg.inv(K)), (480, 320))
    config = PipelineConfig(matching=MatchingConfig(min_disparity=-16, num_disparities=48, correlation_window_size=9))
    result = StereoPipeline(config, rig).process(StereoPair(Frame(left, 0, "left"), Frame(right, 0, "right")))
    inside = result.disparity.disparity_px[40:-40, 80:-40]
    assert np.isfinite(inside).mean() > 0.9
    assert np.nanmedian(inside) == pytest.approx(11, abs=0.2)
    assert not result.metric
    for ask in (lambda: result.depth_m, lambda: result.sigma_m, result.points, lambda: result.triangulation):
        with pytest.raises(CalibrationError, match="not calibrated, its disparities give no depth"):
            ask()


def test_distortion_is_removed_first() -> None:
    """Raw points of both cameras, rectified, against the homographies of undistorted points."""
    D = np.array([-0.2, 0.05, 0.001, -0.0007, 0.0])
    cameras = tuple(
        CameraModel(*SIZE, "plumb_bob", K, D, np.identity(3), np.identity(4)[:3]) for K in (K_LEFT, K_RIGHT)
    )
    rig = UncalibratedRig.from_homographies(FOUND.H_left, FOUND.H_right, SIZE, (cameras[0], cameras[1]))
    points, none = views(50).points_m, np.zeros(3)
    for side, K, moved in ((rig.left, K_LEFT, points), (rig.right, K_RIGHT, points @ POSE.R.T + POSE.t)):
        raw = np.asarray(cv2.projectPoints(moved, none, none, K, D)[0][:, 0], np.float64)
        through = rectify_points(raw, side)
        ideal = moved @ K.T
        H = FOUND.H_left if side is rig.left else FOUND.H_right
        expected = cv2.perspectiveTransform((ideal[:, :2] / ideal[:, 2:])[:, None], H)[:, 0]
        np.testing.assert_allclose(through, expected, atol=1e-5)
    assert Rectifier(rig).rectify_left(np.full(SIZE[::-1], 200, np.uint8)).max() == 200


def test_rigs_of_other_sizes() -> None:
    rig = UncalibratedRig.from_homographies(np.identity(3), np.identity(3), SIZE)
    with pytest.raises(CalibrationError, match=r"left: the image is 100x80, the homographies are for 740x480"):
        Rectifier(rig).rectify_left(np.zeros((80, 100), np.uint8))
    camera = CameraModel(*SIZE, "plumb_bob", K_LEFT, np.zeros(5), np.identity(3), np.identity(4)[:3])
    with pytest.raises(CalibrationError, match=r"left camera: size is 740x480, the homographies are for 640x480"):
        UncalibratedRig.from_homographies(np.identity(3), np.identity(3), (640, 480), (camera, camera))


def check_held_out(matches: Correspondences, size: tuple[int, int]) -> None:
    """Estimated from half of the matches; row errors of the other half, compared with OpenCV's homographies."""
    order = np.random.default_rng(0).permutation(len(matches))
    fitted, held = matches.take(order[::2]), matches.take(order[1::2])
    estimate = estimate_fundamental(fitted.left_px, fitted.right_px)
    found = rectify_uncalibrated(estimate.F, size)
    right = sampson_distance(estimate.F, held.left_px, held.right_px) < 3
    assert right.mean() > 0.9
    left_px, right_px = found.rectified(held.left_px[right], held.right_px[right])
    assert np.median(np.abs(left_px[:, 1] - right_px[:, 1])) <= 0.5
    for shape in (found.shape_left, found.shape_right):
        np.testing.assert_allclose(shape, (90, 1), atol=1e-6)
    check_against_opencv(found, fitted.take(estimate.inliers), estimate.F, size)


def check_against_opencv(
    found: UncalibratedRectification, matches: Correspondences, F: F64, size: tuple[int, int]
) -> None:
    """Whose images are sheared."""
    _, H_left, H_right = cv2.stereoRectifyUncalibrated(matches.left_px, matches.right_px, F, size)
    ours = max(abs(shape.angle_deg - 90) for shape in (found.shape_left, found.shape_right))
    theirs = max(abs(shape_under(H, size).angle_deg - 90) for H in (H_left, H_right))
    assert ours < theirs


@pytest.mark.real_data
def test_euroc(stereo_data: Path) -> None:
    dataset = EurocDataset(stereo_data / "euroc" / "V1_01_micro")
    for pair in list(dataset)[::8]:
        matches = match_features(pair.left.pixels, pair.right.pixels)
        check_held_out(matches.undistorted(dataset.rig.left, dataset.rig.right), (752, 480))


@pytest.mark.real_data
def test_fisheye_scene(stereo_data: Path) -> None:
    """Enlarged twice, to the size of the calibration images."""
    folder = stereo_data / "stereopi" / "fisheye_v2"
    board = create_board("chessboard", (9, 6), 0.025)
    rig = calibrate(find_views(open_stereo_images(folder / "pairs"), board, lambda _: board).views, "equidistant").rig
    scene = cv2.imread(str(folder / "scenes" / "photo.png"), cv2.IMREAD_GRAYSCALE)
    assert scene is not None
    large = np.asarray(cv2.resize(scene, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC), np.uint8)
    matches = match_features(np.ascontiguousarray(large[:, :640]), np.ascontiguousarray(large[:, 640:]))
    check_held_out(matches.undistorted(rig.left, rig.right), (640, 480))

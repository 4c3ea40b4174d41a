# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a light plane: rendered boards, outliers, poses that do not determine it, real sets."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
from light_stripe_images import BOARD_PLANE, POSES, board_camera, board_image, pose
from rendered_boards import SQUARE_M

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane
from stereo_depth_ros.active.light_stripe.plane_calibration import PlaneCalibration, calibrate_plane, fit_plane
from stereo_depth_ros.calibration.chessboard import Chessboard
from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_yaml import camera_to_yaml
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import Frame
from stereo_depth_ros.datasets.numbered_images import numbered_images, read_plain_frame

BOARD = Chessboard((7, 5), SQUARE_M)


@functools.cache
def images() -> tuple[tuple[str, Frame], ...]:
    return tuple((f"{number}.png", board_image(each)) for number, each in enumerate(POSES))


def calibrated(*found: tuple[str, Frame], margin_m: float = 2 * SQUARE_M) -> PlaneCalibration:
    return calibrate_plane(found, BOARD, board_camera(), LightStripeConfig(stripe_channel="green_excess"), margin_m)


def test_the_plane_is_recovered() -> None:
    """Within 0.1 % of the range, and within the stated standard deviations."""
    result = calibrated(*images())
    exact = LightPlane.exact(BOARD_PLANE[:3], float(BOARD_PLANE[3]))
    points = np.concatenate([stripe.points_m for stripe in result.stripes])
    range_m = float(np.linalg.norm(points, axis=1).mean())
    difference = np.abs(
        result.plane.distances(points) - exact.distances(points) * np.sign(exact.normal @ result.plane.normal)
    )
    assert len(result.stripes) == 4
    assert float(difference.max()) < 0.001 * range_m
    assert result.median_m < 0.0002
    assert (difference < 4 * result.plane.sigma_m(points) + 1e-4).all()
    assert not result.dropped
    assert not result.skipped


def test_images_without_board_or_stripe_are_named_and_a_stripe_off_the_plane_is_dropped() -> None:
    gray = Frame(np.full((300, 400, 3), 90, np.uint8), 0, "", "bgr8")
    off = BOARD_PLANE - [0, 0, 0, 0.02]
    others = [
        ("gray.png", gray),
        ("dark.png", board_image(POSES[0], green=0.0)),
        ("off.png", board_image(POSES[1], off)),
    ]
    result = calibrated(*images(), *others)
    assert [text.partition(":")[0] for text in result.skipped] == ["gray.png", "dark.png"]
    assert "no board of 7x5 inner corners" in result.skipped[0]
    assert "the stripe is found on" in result.skipped[1]
    assert [text.partition(":")[0] for text in result.dropped] == ["off.png"]
    assert "mm off the plane of the others" in result.dropped[0]
    assert [stripe.name for stripe in result.stripes] == [name for name, _ in images()]


def test_boards_that_do_not_determine_the_plane_are_refused() -> None:
    """Parallel boards at one distance: the stripes are one line."""
    parallel = [pose(x, y, 0.5, 0.0, 0.0, 0.1) for x, y in ((0.0, 0.0), (0.02, 0.01), (0.01, -0.02))]
    with pytest.raises(CalibrationError, match="stripes of 3 poses are nearly one line") as found:
        calibrated(*((f"{n}", board_image(each)) for n, each in enumerate(parallel)))
    assert "hold the board at different distances, and tilt it" in str(found.value)
    assert "differ by up to 0." in found.value.problem


def test_a_laser_at_the_camera_is_refused() -> None:
    plane = np.array([0.999, 0.02, 0.0, -0.0001])
    frames = [(f"{number}", board_image(each, plane)) for number, each in enumerate(POSES)]
    with pytest.raises(CalibrationError, match=r"passes 0\.\d mm from the camera, its rays meet it at 0\.\d+ degrees"):
        calibrated(*frames)


def test_too_few_poses_and_another_camera_are_refused() -> None:
    with pytest.raises(CalibrationError, match="found in 2 of 2 images, at least 3 are required"):
        calibrated(*images()[:2])
    with pytest.raises(CalibrationError, match="found in 0 of 0 images"):
        calibrated()
    small = Frame(np.zeros((30, 40), np.uint8), 0, "")
    with pytest.raises(CalibrationError, match="the image is 40x30, the camera is calibrated for 400x300") as found:
        calibrated(("s.png", small))
    assert found.value.subject == "s.png"


def test_the_fit_takes_outliers_and_states_what_the_poses_vary() -> None:
    random = np.random.default_rng(2)
    points = random.uniform(-0.2, 0.2, (600, 3)) + np.array([0, 0, 0.6])
    points[:, 0] = 0.1 - 0.3 * points[:, 2]
    groups = np.repeat(np.arange(10), 60)
    points[:, 0] += np.repeat(0.001 * random.normal(size=10), 60)  # the errors of the poses
    points[::9, 0] += 0.05
    plane, weights = fit_plane(points, groups)
    assert (weights[::9] == 0).all()
    exact = LightPlane.exact([1.0, 0.0, 0.3], -0.1)
    assert float(np.abs(plane.normal @ exact.normal)) > np.cos(np.radians(0.5))
    assert 0.0001 < plane.offset_sigma_m < 0.0006  # 1 mm over the square root of ten poses


def real_camera(tmp_path: Path, fx: float, fy: float, cx: float, cy: float, D: list[float]) -> CameraModel:
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    camera = CameraModel(640, 480, "plumb_bob", K, D, np.identity(3), np.column_stack((K, np.zeros(3))))
    (tmp_path / "camera.yaml").write_text(camera_to_yaml(camera, "camera"))
    return read_camera(tmp_path / "camera.yaml")


def real(folder: Path, size: tuple[int, int], camera: CameraModel) -> PlaneCalibration:
    frames = [(path.name, read_plain_frame(path)) for path in numbered_images([folder])]
    config = LightStripeConfig(stripe_channel="green_excess")
    return calibrate_plane(frames, Chessboard(size, 0.04), camera, config, 0.16)


@pytest.mark.real_data
def test_real_boards_seen_by_a_camera_with_oblong_pixels(stereo_data: Path, tmp_path: Path) -> None:
    D = [-0.350373, 0.158447, 0.000735, -0.000231, 0.0]
    camera = real_camera(tmp_path, 514.41205, 685.92876, 329.83671, 237.71471, D)
    result = real(stereo_data / "active" / "c_laser_board_hjamal3", (6, 8), camera)
    assert len(result.stripes) == 6
    assert result.median_m < 0.00018
    assert result.plane.d_m == pytest.approx(-0.0395, abs=0.0005)


@pytest.mark.real_data
def test_real_boards_with_the_stripe_on_their_margin(stereo_data: Path) -> None:
    folder = stereo_data / "active" / "c_laser_turntable_srv"
    result = real(folder / "laser_boards", (8, 6), read_camera(folder / "calibration4.yaml", (640, 480)))
    assert len(result.stripes) == 12
    assert result.median_m < 0.00028
    np.testing.assert_allclose(result.plane.normal, (0.9054, -0.1402, 0.4008), atol=0.002)
    assert result.plane.d_m == pytest.approx(-0.1660, abs=0.0005)

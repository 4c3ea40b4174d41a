# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Turntables: the axis from exact poses, from projected markers with noise, from rendered ones, and a real one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from light_stripe_images import board_camera
from rendered_turntable import AXIS, CORNERS, SIDE_M, TABLE, rendered, rendering_camera, table_pose

from stereo_depth_ros.active.light_stripe.motion import Turntable, turn
from stereo_depth_ros.active.light_stripe.table_targets import BoardTarget, MarkerTargets
from stereo_depth_ros.active.light_stripe.turntable import TableView, Target, axis_from_poses, calibrate_turntable
from stereo_depth_ros.active.light_stripe.turntable_file import read_turntable, write_turntable
from stereo_depth_ros.calibration.chessboard import Chessboard
from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.datasets.numbered_images import read_plain_frame


def view(name: str, angle: float, noise_px: float, seed: int) -> TableView:
    camera, random, targets = board_camera(), np.random.default_rng(seed), {}
    for number, (x, y) in enumerate(((0.06, 0.0), (-0.05, 0.03), (0.0, -0.06))):
        pose = turn(TABLE, angle) @ table_pose(x, y, 0.4 * number)
        points = CORNERS @ pose[:3, :3].T + pose[:3, 3]
        pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, camera.D)[0][:, 0]
        targets[number] = Target(np.arange(4), CORNERS, pixels + noise_px * random.normal(size=(4, 2)))
    return TableView(name, targets)


def offset_m(found: Turntable) -> float:
    """Distance of the true point from the axis found."""
    return float(np.linalg.norm(np.cross(TABLE.point_m - found.point_m, found.axis)))


def test_the_axis_of_exact_poses() -> None:
    """Half turns included, whose sign is not in a single motion."""
    poses = [turn(TABLE, angle) @ table_pose(0.05, 0.02, 0.3) for angle in np.radians([0, 60, 170, 240])]
    found = axis_from_poses(poses)
    np.testing.assert_allclose(found.axis, AXIS, atol=1e-9)
    assert offset_m(found) < 1e-9
    np.testing.assert_allclose(axis_from_poses(poses[::-1]).axis, -AXIS, atol=1e-9)
    with pytest.raises(CalibrationError, match=r"the views turn by 0\.0 degrees, at least 5 are required"):
        axis_from_poses(poses[:1] * 3)


@pytest.mark.parametrize("given", [True, False])
def test_the_axis_of_markers_is_within_the_stated_standard_deviation(given: bool) -> None:
    angles = np.radians([0, 40, 100, 160, 250])
    views = [view(str(n), angle, 0.1, n) for n, angle in enumerate(angles)]
    result = calibrate_turntable(views, board_camera(), angles if given else None)
    assert result.rms_px == pytest.approx(0.14, abs=0.05)
    assert np.degrees(np.arccos(min(float(result.turntable.axis @ AXIS), 1))) < 4 * result.axis_sigma_deg < 1
    assert offset_m(result.turntable) < 4 * result.point_sigma_m < 0.004
    assert float(np.cos(result.angles_rad - angles).min()) > np.cos(np.radians(0.5))
    normal, _ = result.table_plane
    assert abs(float(normal @ AXIS)) > np.cos(np.radians(0.5))


def test_negative_angles_turn_the_axis_around() -> None:
    angles = np.radians([0.0, 50.0, 120.0])
    views = [view(str(n), angle, 0.0, n) for n, angle in enumerate(angles)]
    np.testing.assert_allclose(calibrate_turntable(views, board_camera(), -angles).turntable.axis, -AXIS, atol=1e-4)


def test_views_that_are_not_of_one_table_are_refused() -> None:
    camera, angles = board_camera(), np.radians([0.0, 50.0, 120.0])
    views = [view(str(n), angle, 0.0, n) for n, angle in enumerate(angles)]
    with pytest.raises(CalibrationError, match="targets are found in 1 of 2 images, at least 2 are required"):
        calibrate_turntable([views[0], TableView("empty", {})], camera)
    with pytest.raises(CalibrationError, match=r"the images do not fit one axis, the reprojection rms is \d"):
        calibrate_turntable(views, camera, np.radians([0.0, 90.0, 100.0]))
    with pytest.raises(CalibrationError, match=r"the views turn by 1\.0 degrees"):
        calibrate_turntable(views, camera, np.radians([0.0, 0.5, 1.0]))
    with pytest.raises(CalibrationError, match="b shares no target with the other images"):
        calibrate_turntable([views[0], TableView("b", {9: views[1].targets[0]})], camera)


def test_markers_are_found_in_images() -> None:
    finder = MarkerTargets(SIDE_M, "DICT_4X4_50")
    views = [TableView(str(n), finder.find(rendered(angle))) for n, angle in enumerate(np.radians([0, 70, 200]))]
    assert [sorted(each.targets) for each in views] == [[5, 6, 7]] * 3
    result = calibrate_turntable(views, rendering_camera())
    assert np.degrees(np.arccos(min(float(result.turntable.axis @ AXIS), 1))) < 0.5
    assert offset_m(result.turntable) < 0.001
    assert finder.find(np.full((60, 80), 128, np.uint8)) == {}


def test_a_chessboard_keeps_its_order_from_view_to_view() -> None:
    """The corners of a chessboard that is turned by half a turn look the same; their order follows the last view."""
    board, finder = Chessboard((5, 4), 0.01), BoardTarget(Chessboard((5, 4), 0.01))
    cells = np.kron(np.where(np.indices((5, 6)).sum(axis=0) % 2, 230, 20), np.ones((30, 30))).astype(np.uint8)
    image = np.pad(cells, 60, constant_values=230)
    found = []
    for angle in range(0, 181, 60):
        size = image.shape[::-1]
        turned = cv2.getRotationMatrix2D((size[0] / 2 - 0.5, size[1] / 2 - 0.5), angle, 1.0)
        (target,) = finder.find(cv2.warpAffine(image, turned, size, borderValue=230)).values()
        found.append(target.image_px)
    half_turn = np.array(image.shape[::-1]) - 1 - found[0]
    np.testing.assert_allclose(found[-1], half_turn, atol=0.3)
    assert board.detect(image) is not None
    assert finder.find(np.full((60, 80), 128, np.uint8)) == {}


def test_an_axis_is_read_as_it_was_written(tmp_path: Path) -> None:
    views = [view(str(n), angle, 0.1, n) for n, angle in enumerate(np.radians([0, 60, 130]))]
    result = calibrate_turntable(views, board_camera())
    write_turntable(tmp_path / "t.yaml", result)
    read = read_turntable(tmp_path / "t.yaml")
    np.testing.assert_allclose(read.axis, result.turntable.axis, rtol=1e-12)
    np.testing.assert_allclose(read.point_m, result.turntable.point_m, rtol=1e-12)
    for text, problem in (("", "lacks the key"), ("turntable: {axis: [0, 0, 0], point_m: [0, 0, 1]}", "axis is 0")):
        (tmp_path / "bad.yaml").write_text(text)
        with pytest.raises(CalibrationError, match=problem):
            read_turntable(tmp_path / "bad.yaml")


@pytest.mark.real_data
def test_a_real_turntable(stereo_data: Path) -> None:
    """Four markers turned by steps of 90 degrees; the axis is perpendicular to the plane of the markers."""
    folder, finder = stereo_data / "active" / "c_laser_turntable_srv", MarkerTargets(0.03, "DICT_4X4_50")
    paths = [folder / "table" / f"step_num_table{number}.jpg" for number in (1, 81, 161, 241)]
    views = [TableView(path.name, finder.find(to_gray(read_plain_frame(path)))) for path in paths]
    camera = read_camera(folder / "calibration4.yaml", (640, 480))
    free, given = (calibrate_turntable(views, camera, a) for a in (None, np.radians([0.0, 90.0, 180.0, 270.0])))
    assert free.rms_px < 0.5
    assert given.rms_px < 0.8
    assert float(free.turntable.axis @ given.turntable.axis) > np.cos(np.radians(0.2))
    assert float(np.cos(free.angles_rad - given.angles_rad).min()) > np.cos(np.radians(1.5))
    assert abs(float(given.table_plane[0] @ given.turntable.axis)) > np.cos(np.radians(0.5))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of range sensors: clouds of any layout, scans, depth images, and what is dropped of them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from range_messages import cloud, depth_image, laser_scan, xyz_cloud

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, MessageError
from stereo_depth_ros.messages.depth import depth_pixels
from stereo_depth_ros.messages.range_sensor import range_points

RNG = np.random.default_rng(4)
POINTS = RNG.uniform(-9, 9, (6, 3)).astype(np.float32)
NAN = np.float32(np.nan)
K = np.array([[52.0, 0, 7.2], [0, 49.0, 5.1], [0, 0, 1]])
TURN = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
CAMERA = CameraModel(9, 6, "plumb_bob", K, np.zeros(5), np.identity(3), np.column_stack([K, np.zeros(3)]), "tof")


def records(fields: list[tuple[str, str]], shape: tuple[int, ...] = (6,)) -> np.ndarray[Any, Any]:
    made = np.zeros(shape, np.dtype(fields))
    for at, name in enumerate("xyz"):
        made[name] = POINTS[:, at].reshape(shape)
    return made


@pytest.mark.parametrize(
    ("fields", "shape"),
    [
        ([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], (6,)),
        ([("intensity", "<u2"), ("z", "<f4"), ("a", "<u1"), ("x", "<f4"), ("y", "<f4")], (6,)),
        ([("x", ">f8"), ("y", ">f8"), ("z", ">f8"), ("ring", ">u2")], (2, 3)),
        ([("y", "<f8"), ("x", "<f4"), ("ring", "<u1"), ("z", "<f8")], (3, 2)),
    ],
)
def test_clouds_of_any_layout(fields: list[tuple[str, str]], shape: tuple[int, ...]) -> None:
    found = range_points(cloud(records(fields, shape), 12_345, "front_lidar", row_padding=5 * (len(shape) - 1)))
    np.testing.assert_array_equal(found.points_m, POINTS)
    assert found.points_m.dtype == np.float32
    assert (found.stamp_ns, found.frame_id, found.times_ns, found.dropped) == (12_345, "front_lidar", None, {})


def test_whole_numbers_are_points_too() -> None:
    made = np.zeros(2, np.dtype([("x", "<i2"), ("y", "<i4"), ("z", "<u1")]))
    made["x"], made["y"], made["z"] = [-3, 4], [70_000, 1], [2, 255]
    np.testing.assert_array_equal(range_points(cloud(made)).points_m, [[-3, 70_000, 2], [4, 1, 255]])


def test_points_that_are_none_are_dropped_and_counted() -> None:
    points = POINTS.copy()
    points[1, 2], points[3, 0], points[4] = NAN, np.inf, 0
    found = range_points(xyz_cloud(points))
    np.testing.assert_array_equal(found.points_m, POINTS[[0, 2, 5]])
    assert found.dropped == {"not finite": 2, "at the origin": 1}
    assert len(range_points(xyz_cloud(points[:0]))) == 0


@pytest.mark.parametrize(
    ("name", "kind", "values"),
    [
        ("t", "<u4", [0, 20_000_000, 40_000_000]),  # Ouster
        ("time", "<f4", [0.0, 0.02, 0.04]),  # Velodyne
        ("timestamp", "<f8", [1_700_000_005.25, 1_700_000_005.27, 1_700_000_005.29]),  # Hesai
        ("offset_time", "<u4", [0, 20_000_000, 40_000_000]),  # Livox
    ],
)
def test_times_of_points(name: str, kind: str, values: list[float]) -> None:
    made = np.zeros(3, np.dtype([("x", "<f4"), (name, kind), ("y", "<f4"), ("z", "<f4")]))
    made["x"], made[name] = [1, NAN, 3], values
    found = range_points(cloud(made, 1_700_000_005_250_000_000)).times_ns
    assert found is not None
    np.testing.assert_allclose(found, [0, 40_000_000], atol=1000)


def test_scans_with_their_rays_and_times() -> None:
    ranges = np.array([2.0, np.inf, 0.05, 3.0, NAN, 12.5, 4.0], np.float32)
    found = range_points(laser_scan(ranges, 77))
    angles = np.radians([-30.0, -27.0, -24.0])
    expected = np.array([2.0, 3.0, 4.0])[:, None] * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    np.testing.assert_allclose(found.points_m, expected, rtol=1e-6)
    np.testing.assert_array_equal(found.times_ns, [0, 3_000_000, 6_000_000])
    assert found.dropped == {"not finite": 2, "out of range": 2}


@pytest.mark.parametrize(("encoding", "tolerance"), [("16UC1", 6e-4), ("32FC1", 1e-6)])
def test_depth_images(encoding: str, tolerance: float) -> None:
    depth_m = RNG.uniform(0.4, 5, (6, 9)).astype(np.float32)
    depth_m[2, 3] = depth_m[5, 8] = NAN
    message = depth_image(depth_m, encoding, padding=3)
    np.testing.assert_allclose(depth_pixels(message), depth_m, atol=tolerance)
    found = range_points(message, camera=CAMERA)
    assert (len(found), found.dropped) == (52, {"without depth": 2})
    x, y, z = found.points_m[9 + 4]  # row 1, column 4
    np.testing.assert_allclose([52 * x / z + 7.2, 49 * y / z + 5.1, z], [4, 1, depth_m[1, 4]], atol=2e-3)


def test_the_points_of_a_rectified_depth_image_are_in_the_frame_of_its_camera() -> None:
    depth_m = np.full((6, 9), 2.5, np.float32)
    found = range_points(depth_image(depth_m, "32FC1"), camera=replace(CAMERA, R=TURN))
    straight = range_points(depth_image(depth_m, "32FC1"), camera=CAMERA)
    np.testing.assert_allclose(found.points_m @ TURN.T, straight.points_m, atol=1e-6)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"fields": []}, "has no field x and y and z"),
        ({"point_step": 8}, r"field z is 1 values of datatype 7 at byte 8 of 8"),
        ({"width": 60}, r"data has 96 bytes .*60x1 points of 16 bytes take 960"),
        ({"height": 2, "row_step": 40}, r"rows of 40, 6x2 points"),
    ],
)
def test_clouds_that_contradict_themselves_are_refused(changed: dict[str, Any], text: str) -> None:
    message = replace(xyz_cloud(POINTS), **changed)
    with pytest.raises(MessageError, match=f"^/points: .*{text}"):
        range_points(message, "/points")


def test_the_camera_of_depth_images_must_be_calibrated() -> None:
    image = depth_image(np.ones((6, 9), np.float32), "32FC1")
    blank = replace(CAMERA, K=np.zeros((3, 3)), P=np.zeros((3, 4)), R=np.zeros((3, 3)))
    with pytest.raises(CalibrationError, match=r"^/sensor: not calibrated"):
        range_points(image, "/sensor", blank)
    flat = replace(CAMERA, P=np.diag([0.0, 1, 1])[:, [0, 1, 2, 2]])
    with pytest.raises(CalibrationError, match=r"^/sensor: "):
        range_points(image, "/sensor", flat)
    raw = range_points(image, "/sensor", replace(CAMERA, P=np.zeros((3, 4))))  # K counts
    np.testing.assert_array_equal(raw.points_m, range_points(image, "/sensor", CAMERA).points_m)


def test_other_messages_are_refused() -> None:
    scan = laser_scan(np.ones(3, np.float32), angle_increment=float("nan"))
    image = depth_image(np.ones((6, 9), np.float32), "32FC1")
    cases: list[tuple[Any, CameraModel | None, str]] = [
        (scan, None, "angle_min, angle_increment, range_min"),
        (image, None, "a depth image lacks its camera info"),
        (replace(image, encoding="rgb8"), CAMERA, "encoding 'rgb8', a depth image is one of 16UC1"),
        (replace(image, height=7), CAMERA, "data has 216 bytes"),
        (image, replace(CAMERA, width=8), "the depth image is 9x6, its camera info is for 8x6"),
        (SimpleNamespace(), None, "is a SimpleNamespace"),
    ]
    for message, camera, text in cases:
        with pytest.raises(MessageError, match=text):
            range_points(message, "/sensor", camera)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera infos: binning and region of interest by hand, and what is written is read."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import camera_from_info, sensor_intrinsics
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import camera_info_message, rectified_camera_info


def info(roi: tuple[int, int, int, int] = (0, 0, 0, 0), binning: tuple[int, int] = (0, 0)) -> Any:
    x, y, width, height = roi
    return SimpleNamespace(
        header=SimpleNamespace(frame_id="right_frame"),
        width=640,
        height=400,
        distortion_model="plumb_bob",
        d=[-0.2, 0.1, 0.001, 0.002, 0.0],
        k=[500.0, 0, 330, 0, 480, 210, 0, 0, 1],
        r=np.identity(3).ravel(),
        p=[450.0, 0, 310, -54, 0, 440, 190, 0, 0, 0, 1, 0],
        binning_x=binning[0],
        binning_y=binning[1],
        roi=SimpleNamespace(x_offset=x, y_offset=y, width=width, height=height, do_rectify=False),
    )


@pytest.mark.parametrize("binning", [(0, 0), (1, 1)])
@pytest.mark.parametrize("roi", [(0, 0, 0, 0), (0, 0, 640, 400)])
def test_whole_sensor(roi: tuple[int, int, int, int], binning: tuple[int, int]) -> None:
    camera = camera_from_info(info(roi, binning))
    assert (camera.width, camera.height, camera.frame_id) == (640, 400, "right_frame")
    np.testing.assert_array_equal(camera.K, [[500, 0, 330], [0, 480, 210], [0, 0, 1]])
    np.testing.assert_array_equal(camera.P, [[450, 0, 310, -54], [0, 440, 190, 0], [0, 0, 1, 0]])


def test_region_of_interest_shifts() -> None:
    camera = camera_from_info(info((100, 40, 320, 300)))
    assert (camera.width, camera.height) == (320, 300)
    np.testing.assert_array_equal(camera.K, [[500, 0, 230], [0, 480, 170], [0, 0, 1]])
    np.testing.assert_array_equal(camera.P, [[450, 0, 210, -54], [0, 440, 150, 0], [0, 0, 1, 0]])


def test_binning_divides_rows() -> None:
    camera = camera_from_info(info(binning=(2, 4)))
    assert (camera.width, camera.height) == (320, 100)
    np.testing.assert_array_equal(camera.K, [[250, 0, 165], [0, 120, 52.5], [0, 0, 1]])
    np.testing.assert_array_equal(camera.P, [[225, 0, 155, -27], [0, 110, 47.5, 0], [0, 0, 1, 0]])


def test_region_is_in_pixels_before_binning() -> None:
    camera = camera_from_info(info((100, 40, 320, 300), (2, 4)))
    assert (camera.width, camera.height) == (160, 75)
    np.testing.assert_array_equal(camera.K, [[250, 0, 115], [0, 120, 42.5], [0, 0, 1]])
    np.testing.assert_array_equal(camera.P, [[225, 0, 105, -27], [0, 110, 37.5, 0], [0, 0, 1, 0]])
    np.testing.assert_array_equal(camera.D, [-0.2, 0.1, 0.001, 0.002, 0.0])


def test_intrinsics_of_the_image_are_given_for_the_sensor() -> None:
    K = sensor_intrinsics(np.array([[250.0, 0, 115], [0, 120, 42.5], [0, 0, 1]]), info((100, 40, 320, 300), (2, 4)))
    np.testing.assert_array_equal(K, [[500, 0, 330], [0, 480, 210], [0, 0, 1]])


@pytest.mark.parametrize("binning", [(0, 0), (3, 2)])
@pytest.mark.parametrize("roi", [(0, 0, 0, 0), (101, 43, 321, 300)])
def test_a_receiver_of_sensor_intrinsics_gets_those_of_the_image(
    roi: tuple[int, int, int, int], binning: tuple[int, int]
) -> None:
    message = info(roi, binning)
    np.testing.assert_allclose(sensor_intrinsics(camera_from_info(message).K, message).ravel(), message.k, rtol=1e-14)
    K = np.array([[171.3, 0, 83.9], [0, 244.7, 61.2], [0, 0, 1]])
    message.k = sensor_intrinsics(K, message).ravel()
    np.testing.assert_allclose(camera_from_info(message).K, K, rtol=1e-14)


@pytest.mark.parametrize("roi", [(400, 0, 241, 400), (0, 300, 640, 101), (0, 0, 0, 400), (0, 0, 640, 0)])
def test_region_outside_the_sensor(roi: tuple[int, int, int, int]) -> None:
    with pytest.raises(CalibrationError, match=r"/left/camera_info: roi .* is not inside the sensor of 640x400"):
        camera_from_info(info(roi), "/left/camera_info")


@pytest.mark.parametrize(
    ("model", "D"),
    [("plumb_bob", []), ("rational_polynomial", np.arange(8) / 7), ("equidistant", np.arange(4) / 3)],
)
def test_written_is_read_through_cdr(model: str, D: Any) -> None:
    types = RosbagsTypes()
    values = np.random.default_rng(3).normal(size=30)
    camera = CameraModel(752, 480, model, values[:9], np.array(D), values[9:18], values[18:], "cam0")
    message = camera_info_message(types, camera, 12_345_678_901)
    copy = types.deserialize(types.serialize(message), "sensor_msgs/msg/CameraInfo")
    assert (copy.header.stamp.sec, copy.header.stamp.nanosec) == (12, 345_678_901)
    read = camera_from_info(copy)
    for name in ("width", "height", "distortion_model", "frame_id"):
        assert getattr(read, name) == getattr(camera, name)
    for name in ("K", "D", "R", "P"):
        np.testing.assert_array_equal(getattr(read, name), getattr(camera, name))
    assert camera_info_message(types, camera, 0, "other").header.frame_id == "other"


def test_info_of_a_rectified_image() -> None:
    K = np.array([[400.0, 0, 150], [0, 410, 97], [0, 0, 1]])
    rig = StereoRig.from_calibration(
        K, [-0.2, 0.1, 0, 0], K, [-0.1, 0, 0, 0], np.identity(3), [-0.12, 0.01, 0], (320, 200), frame_id="left_frame"
    )
    message = rectified_camera_info(RosbagsTypes(), rig.left, 7)
    assert (message.width, message.height, message.distortion_model) == (320, 200, "plumb_bob")
    assert message.header.frame_id == "left_frame"
    f_px, cx, cy = rig.f_px, rig.cx_left, rig.cy
    np.testing.assert_array_equal(message.k, [f_px, 0, cx, 0, rig.fy_px, cy, 0, 0, 1])
    np.testing.assert_array_equal(message.p, [f_px, 0, cx, 0, 0, rig.fy_px, cy, 0, 0, 0, 1, 0])
    np.testing.assert_array_equal(message.r, np.identity(3).ravel())
    np.testing.assert_array_equal(message.d, np.zeros(5))

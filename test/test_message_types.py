# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The message factory: times, payloads, and equal bytes from rosbags' and rclpy's messages."""

from __future__ import annotations

import array
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.messages.types import MessageTypes, make_header, stamp_ns


def _keeping_data(message_class: Any) -> Callable[..., Any]:
    """The class without its copies of ``data``: only a setter that checks fields takes the array itself."""

    def build(*, data: Any, **fields: Any) -> Any:
        message = message_class(check_fields=True, **fields)
        message.data = data
        return message

    return build


class RclpyTypes:
    """The least that satisfies the protocol with rclpy's classes."""

    def __init__(self) -> None:
        pytest.importorskip("rclpy")
        import builtin_interfaces.msg
        import sensor_msgs.msg
        import std_msgs.msg
        import stereo_msgs.msg

        self.Time: Any = builtin_interfaces.msg.Time
        self.Header: Any = std_msgs.msg.Header
        self.Image: Any = _keeping_data(sensor_msgs.msg.Image)
        self.CompressedImage: Any = _keeping_data(sensor_msgs.msg.CompressedImage)
        self.CameraInfo: Any = sensor_msgs.msg.CameraInfo
        self.RegionOfInterest: Any = sensor_msgs.msg.RegionOfInterest
        self.PointField: Any = sensor_msgs.msg.PointField
        self.PointCloud2: Any = _keeping_data(sensor_msgs.msg.PointCloud2)
        self.DisparityImage: Any = stereo_msgs.msg.DisparityImage

    def payload(self, nbytes: int) -> tuple[Any, U8]:
        data = array.array("B", bytes(nbytes))
        return data, np.frombuffer(data, np.uint8)

    def float64s(self, values: F64) -> Any:
        return array.array("d", values.tobytes())

    def serialize(self, message: Any) -> bytes:
        from rclpy.serialization import serialize_message

        return bytes(serialize_message(message))


def _image(types: MessageTypes) -> Any:
    data, view = types.payload(3 * 7)
    view[:] = np.arange(21)
    header = make_header(types, 1_700_000_000_123_456_789, "left_optical")
    return types.Image(header=header, height=3, width=7, encoding="mono8", is_bigendian=0, step=7, data=data)


def _camera_info(types: MessageTypes, distortion: tuple[float, ...] = (0.1, -0.2, 0.003, 0.004, 0.05)) -> Any:
    return types.CameraInfo(
        header=make_header(types, 5, "l"),
        height=481,
        width=643,
        distortion_model="plumb_bob",
        d=types.float64s(np.array(distortion)),
        k=np.array([500.0, 0, 320, 0, 510, 240, 0, 0, 1]),
        r=np.identity(3).ravel(),
        p=np.array([500.0, 0, 320, -60, 0, 510, 240, 0, 0, 0, 1, 0]),
        binning_x=0,
        binning_y=2,
        roi=types.RegionOfInterest(x_offset=1, y_offset=2, height=3, width=4, do_rectify=True),
    )


def _disparity_image(types: MessageTypes) -> Any:
    image = _image(types)
    return types.DisparityImage(
        header=image.header,
        image=image,
        f=500.5,
        t=0.12,
        valid_window=types.RegionOfInterest(x_offset=1, y_offset=2, height=3, width=4, do_rectify=False),
        min_disparity=-3.0,
        max_disparity=60.0,
        delta_d=0.0625,
    )


def _point_cloud(types: MessageTypes) -> Any:
    data, view = types.payload(13)
    view[:] = np.arange(13)
    fields = [types.PointField(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate(("x", "y", "zz"))]
    return types.PointCloud2(
        header=make_header(types, 6, "cloud"),
        height=1,
        width=1,
        fields=fields,
        is_bigendian=False,
        point_step=13,
        row_step=13,
        data=data,
        is_dense=False,
    )


def _compressed_image(types: MessageTypes) -> Any:
    data, view = types.payload(5)
    view[:] = (255, 216, 1, 2, 3)
    return types.CompressedImage(header=make_header(types, 7, "l"), format="mono8; jpeg compressed", data=data)


def assert_equal_bytes(live: Any, offline: Any) -> None:
    """The CDR bytes of rclpy's message and of rosbags' message agree.

    Fast CDR leaves alignment gaps uninitialised, so rclpy's bytes differ from one call to the next. The gaps are zeroed
    by reading the bytes and writing them again; their number is compared before that.
    """
    types = RosbagsTypes()
    live_bytes, offline_bytes = RclpyTypes().serialize(live), types.serialize(offline)
    assert len(live_bytes) == len(offline_bytes)
    assert types.serialize(types.deserialize(live_bytes, offline.__msgtype__)) == offline_bytes


@pytest.mark.parametrize(
    "build",
    [
        _image,
        _camera_info,
        lambda types: _camera_info(types, ()),
        _disparity_image,
        _point_cloud,
        _compressed_image,
    ],
)
def test_rosbags_and_rclpy_give_equal_bytes(build: Callable[[MessageTypes], Any]) -> None:
    assert_equal_bytes(build(RclpyTypes()), build(RosbagsTypes()))


def test_serialize_writes_the_cdr_of_the_image_definition() -> None:
    types = RosbagsTypes()
    message = types.Image(
        header=make_header(types, 2_000_000_003, "ab"),
        height=1,
        width=3,
        encoding="mono8",
        is_bigendian=0,
        step=3,
        data=np.array([7, 8, 9], np.uint8),
    )
    expected = (
        b"\x00\x01\x00\x00"  # encapsulation: CDR, little-endian
        b"\x02\x00\x00\x00\x03\x00\x00\x00"  # sec, nanosec
        b"\x03\x00\x00\x00ab\x00\x00"  # length with terminator, text, alignment
        b"\x01\x00\x00\x00\x03\x00\x00\x00"  # height, width
        b"\x06\x00\x00\x00mono8\x00\x00\x00"  # encoding, is_bigendian, alignment
        b"\x03\x00\x00\x00\x03\x00\x00\x00\x07\x08\x09"  # step, length, data
    )
    assert types.serialize(message) == expected


def test_deserialize_returns_what_was_serialized() -> None:
    types = RosbagsTypes()
    data = types.serialize(_camera_info(types))
    info = types.deserialize(data, "sensor_msgs/msg/CameraInfo")
    assert (info.height, info.width, info.header.frame_id, info.binning_y) == (481, 643, "l", 2)
    np.testing.assert_array_equal(info.d, [0.1, -0.2, 0.003, 0.004, 0.05])
    np.testing.assert_array_equal(info.p, [500, 0, 320, -60, 0, 510, 240, 0, 0, 0, 1, 0])
    assert info.roi.do_rectify is True
    assert stamp_ns(info.header) == 5


@pytest.mark.parametrize("cut", [0, 3, 20, 60])
def test_deserialize_refuses_truncated_bytes(cut: int) -> None:
    types = RosbagsTypes()
    data = types.serialize(_image(types))[:cut]
    with pytest.raises(MessageError, match=rf"^{cut} bytes are not a sensor_msgs/msg/Image .*record it again"):
        types.deserialize(data, "sensor_msgs/msg/Image")


def test_deserialize_refuses_an_unknown_type() -> None:
    with pytest.raises(MessageError, match=r"message type 'my_msgs/msg/Stereo' is not among the .* register"):
        RosbagsTypes().deserialize(b"\x00\x01\x00\x00", "my_msgs/msg/Stereo")


@pytest.mark.parametrize("family", [RosbagsTypes, RclpyTypes])
def test_payload_and_its_view_are_the_same_memory(family: Callable[[], MessageTypes]) -> None:
    data, view = family().payload(5)
    assert (view.dtype, view.shape) == (np.uint8, (5,))
    view[3] = 77
    assert bytes(data) == b"\x00\x00\x00\x4d\x00"


@pytest.mark.parametrize("family", [RosbagsTypes, RclpyTypes])
def test_float64s_is_a_copy(family: Callable[[], MessageTypes]) -> None:
    values = np.array([1.5, -2.25, 1e300])
    field = family().float64s(values)
    values[0] = 0.0
    assert list(field) == [1.5, -2.25, 1e300]


@pytest.mark.parametrize(
    ("time_ns", "sec", "nanosec"),
    [(0, 0, 0), (999_999_999, 0, 999_999_999), (1_700_000_000_000_000_001, 1_700_000_000, 1), (-1, -1, 999_999_999)],
)
def test_header_time_is_exact(time_ns: int, sec: int, nanosec: int) -> None:
    header = make_header(RosbagsTypes(), time_ns, "left")
    assert (header.stamp.sec, header.stamp.nanosec, header.frame_id) == (sec, nanosec, "left")
    assert stamp_ns(header) == time_ns


def test_stamp_ns_does_not_overflow_numpy_integers() -> None:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=np.int32(2_000_000_000), nanosec=np.uint32(4)))
    assert stamp_ns(header) == 2_000_000_000_000_000_004

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages sent from the memory of their payload: the message that rclpy sends, whatever the size of its fields."""

from __future__ import annotations

import array
import copy
from typing import Any

import graph_harness  # noqa: F401  (its domain)
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image, PointCloud2, PointField, RegionOfInterest
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.nodes import sending
from stereo_depth_ros.nodes.message_types import RclpyTypes

TYPES = RclpyTypes()
HEADER = Header(stamp=Time(sec=7, nanosec=123456789), frame_id="links_optisch")


def image(width: int, height: int, channels: int = 1, frame_id: str = "links_optisch") -> Any:
    data, view = TYPES.payload(width * height * channels)
    view[:] = np.arange(view.size) * 7 % 251
    header = Header(stamp=HEADER.stamp, frame_id=frame_id)
    encoding = {1: "mono8", 3: "bgr8", 4: "32FC1"}[channels]
    return TYPES.Image(
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=width * channels,
        data=data,
    )


def cloud(points: int, step: int) -> Any:
    data, view = TYPES.payload(points * step)
    view[:] = np.arange(view.size) * 11 % 253
    fields = [PointField(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate(("x", "y", "z", "rgb"))]
    return TYPES.PointCloud2(
        header=HEADER,
        height=1,
        width=points,
        fields=fields,
        is_bigendian=False,
        point_step=step,
        row_step=points * step,
        data=data,
        is_dense=True,
    )


def disparity(width: int, height: int) -> Any:
    return TYPES.DisparityImage(
        header=HEADER,
        image=image(width, height, 4),
        f=123.5,
        t=0.125,
        valid_window=RegionOfInterest(x_offset=3, y_offset=5, height=7, width=11, do_rectify=True),
        min_disparity=-2.0,
        max_disparity=61.0,
        delta_d=0.0625,
    )


def assert_is(sent: bytes, message: Any) -> None:
    """It has the length and the fields of what rclpy sends; Fast CDR leaves the bytes between fields as they are."""
    holder = getattr(message, "image", message)
    payload = holder._data
    holder._data = array.array("B", payload.tobytes())
    try:
        assert len(sent) == len(serialize_message(message))
        assert deserialize_message(sent, type(message)) == message
    finally:
        holder._data = payload


class FakeHandle:
    pointer = 4711

    def __enter__(self) -> FakeHandle:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class FakePublisher:
    """Notes what rclpy is asked to publish."""

    handle = FakeHandle()

    def __init__(self) -> None:
        self.by_rclpy: list[Any] = []

    def publish(self, message: Any) -> None:
        self.by_rclpy.append(copy.copy(message))


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The bytes given to rcl."""
    received: list[bytes] = []

    def publish(pointer: int, message: Any, allocation: None) -> int:
        assert (pointer, allocation) == (4711, None)
        fields = message._obj
        assert fields.buffer_length == fields.buffer_capacity
        received.append(sending.ctypes.string_at(fields.buffer, fields.buffer_length))
        return 0

    monkeypatch.setattr(sending, "_publish_function", lambda: publish)
    return received


@pytest.mark.parametrize(
    "message",
    [
        image(5, 3),
        image(7, 9, 3),
        image(64, 48, 4),
        image(1, 1),
        cloud(13, 16),
        cloud(5, 32),
        disparity(7, 5),
        disparity(64, 48),
    ],
    ids=lambda message: f"{type(message).__name__}-{getattr(message, 'width', '')}",
)
def test_message_is_that_of_rclpy(message: Any, sent: list[bytes]) -> None:
    publisher = FakePublisher()
    sending.send(publisher, message)
    sending.send(publisher, message)  # the memory is used again
    assert len(sent) == 2
    for each in sent:
        assert_is(each, message)
    assert publisher.by_rclpy == []


def test_payload_lies_where_kernels_want_it() -> None:
    for nbytes in (1, 63, 4096, 100_003):
        payload = sending.Payload.allocate(nbytes)
        assert payload.ctypes.data % 64 == 0
        assert payload.shape == (nbytes,)
        assert not payload.any()


@pytest.mark.parametrize("length", [100, 3900, 5000])
def test_long_frame_id_is_published_one_way_or_the_other(length: int, sent: list[bytes]) -> None:
    publisher = FakePublisher()
    message = image(5, 3, frame_id="f" * length)
    sending.send(publisher, message)
    assert len(sent) + len(publisher.by_rclpy) == 1
    assert bool(sent) == (length < 4000)
    if sent:
        assert_is(sent[0], message)
    else:
        assert publisher.by_rclpy[0].data.tobytes() == message.data.tobytes()


def test_without_the_function_of_rcl_rclpy_publishes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "_publish_function", lambda: None)
    publisher = FakePublisher()
    message = cloud(3, 16)
    sending.send(publisher, message)
    assert len(publisher.by_rclpy) == 1
    assert_is(bytes(serialize_message(publisher.by_rclpy[0])), message)


def test_refusal_of_rcl_is_left_to_rclpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "_publish_function", lambda: lambda *_: 300)
    publisher = FakePublisher()
    sending.send(publisher, image(5, 3))
    assert len(publisher.by_rclpy) == 1


def test_other_messages_are_published_by_rclpy(sent: list[bytes]) -> None:
    publisher = FakePublisher()
    for message in (Image(data=b"abc"), PointCloud2(), DisparityImage(), Header()):
        sending.send(publisher, message)
    assert (len(publisher.by_rclpy), sent) == (4, [])


def test_function_of_rcl_is_found() -> None:
    assert sending._publish_function() is not None

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages sent from the memory of their payload: the message that rclpy sends, whatever the size of its fields."""

from __future__ import annotations

import array
import copy
import functools
from collections.abc import Callable
from typing import Any

import graph_harness  # noqa: F401  (its domain)
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.messages.types import make_header
from stereo_depth_ros.nodes import sending
from stereo_depth_ros.nodes.message_types import RclpyTypes

TYPES = RclpyTypes()
FRAME_ID = "links_optisch"


def header(types: Any, frame_id: str = FRAME_ID) -> Any:
    return make_header(types, 7_123_456_789, frame_id)


def image(width: int, height: int, channels: int = 1, frame_id: str = FRAME_ID, types: Any = TYPES) -> Any:
    data, view = types.payload(width * height * channels)
    view[:] = np.arange(view.size) * 7 % 251
    encoding = {1: "mono8", 3: "bgr8", 4: "32FC1"}[channels]
    return types.Image(
        header=header(types, frame_id),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=width * channels,
        data=data,
    )


def cloud(points: int, step: int, types: Any = TYPES) -> Any:
    data, view = types.payload(points * step)
    view[:] = np.arange(view.size) * 11 % 253
    names = ("x", "y", "z", "rgb")
    fields = [types.PointField(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate(names)]
    return types.PointCloud2(
        header=header(types),
        height=1,
        width=points,
        fields=fields,
        is_bigendian=False,
        point_step=step,
        row_step=points * step,
        data=data,
        is_dense=True,
    )


def compressed(size: int) -> Any:
    data, view = TYPES.payload(size)
    view[:] = np.arange(size) * 13 % 241
    return TYPES.CompressedImage(header=header(TYPES), format="png", data=data)


def disparity(width: int = 7, height: int = 5, types: Any = TYPES) -> Any:
    return types.DisparityImage(
        header=header(types),
        image=image(width, height, 4, types=types),
        f=123.5,
        t=0.125,
        valid_window=types.RegionOfInterest(x_offset=3, y_offset=5, height=7, width=11, do_rectify=True),
        min_disparity=-2.0,
        max_disparity=61.0,
        delta_d=0.0625,
    )


def assert_is(sent: bytes, message: Any) -> None:
    """It has the length and the fields of what rclpy sends, which leaves the bytes that align a field as they are."""
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
        compressed(1),
        compressed(999),
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


@pytest.mark.parametrize("name", ["", "a", "ab", "abc", "abcd", "größe"])
def test_names_of_any_length(name: str, sent: list[bytes]) -> None:
    message = cloud(3, 16)
    message.header.frame_id = name
    message.fields[1].name = name
    sending.send(FakePublisher(), message)
    assert_is(sent[0], message)


@pytest.mark.parametrize("build", [functools.partial(image, 7, 9, 3), functools.partial(cloud, 13, 16), disparity])
def test_bytes_are_those_of_the_offline_engine(build: Callable[..., Any], sent: list[bytes]) -> None:
    """Also those that align a field, which rclpy leaves as they are."""
    sending.send(FakePublisher(), build())
    offline = RosbagsTypes()
    assert sent == [offline.serialize(build(types=offline))]


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

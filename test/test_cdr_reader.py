# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages from the CDR bytes that a subscription receives: as rosbags reads them, and what is not a message."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.messages.cdr_reader import READ_TYPES, read_message
from stereo_depth_ros.messages.types import make_header

TYPES = RosbagsTypes()
REGION = TYPES.RegionOfInterest(x_offset=1, y_offset=2, height=3, width=4, do_rectify=True)
IMAGE = TYPES.Image(
    header=make_header(TYPES, 1_700_000_000_123_456_789, "left"),
    height=3,
    width=7,
    encoding="mono8",
    is_bigendian=1,
    step=8,
    data=np.arange(24, dtype=np.uint8),
)


def camera_info(distortion: tuple[float, ...]) -> Any:
    return TYPES.CameraInfo(
        header=make_header(TYPES, -5, "r"),
        height=481,
        width=643,
        distortion_model="plumb_bob",
        d=np.array(distortion, np.float64),
        k=np.arange(9.0),
        r=np.arange(10.0, 19),
        p=np.arange(20.0, 32),
        binning_x=1,
        binning_y=2,
        roi=REGION,
    )


MESSAGES = (
    IMAGE,
    camera_info(()),
    camera_info((0.1, -0.2, 0.003, 0.004, 0.05)),
    TYPES.CompressedImage(header=IMAGE.header, format="jpeg", data=np.arange(5, dtype=np.uint8)),
    TYPES.DisparityImage(
        header=IMAGE.header,
        image=IMAGE,
        f=500.5,
        t=0.125,
        valid_window=REGION,
        min_disparity=-3.0,
        max_disparity=60.0,
        delta_d=0.0625,
    ),
)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.__msgtype__)
def test_what_is_read_is_what_was_written_and_no_beginning_of_it(message: Any) -> None:
    msgtype, data = message.__msgtype__, TYPES.serialize(message)
    read = read_message(TYPES, data, msgtype)
    image = getattr(read, "image", read)
    if hasattr(image, "data"):
        assert np.shares_memory(np.frombuffer(image.data, np.uint8), np.frombuffer(data, np.uint8))
        image.data = np.frombuffer(image.data, np.uint8)
    assert TYPES.serialize(read) == data
    for size in range(len(data)):
        with pytest.raises(MessageError, match=f"^{size} bytes are not a {msgtype}: its publisher is broken"):
            read_message(TYPES, data[:size], msgtype)


def test_all_types_are_tested() -> None:
    assert {message.__msgtype__ for message in MESSAGES} == READ_TYPES


def test_big_endian() -> None:
    data = b"\x00\x00\x00\x00" + struct.pack(">iII3sx", 3, 4, 3, b"ab\0") + struct.pack(">II", 1, 3)
    data += struct.pack(">I6sBxII3s", 6, b"mono8\0", 1, 3, 3, b"\7\10\11")
    message = read_message(TYPES, data, "sensor_msgs/msg/Image")
    assert (message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id) == (3, 4, "ab")
    assert (message.height, message.width, message.encoding, message.is_bigendian) == (1, 3, "mono8", 1)
    assert (message.step, bytes(message.data)) == (3, b"\7\10\11")


@pytest.mark.parametrize(
    ("place", "there"),
    [(0, b"\7\7"), (12, b"\xff\xff\xff\xff"), (16, b"\xff"), (48, b"\xff\xff\xff\x7f")],
    ids=["encapsulation", "length of a text", "text that is not UTF-8", "length of the data"],
)
def test_bytes_that_are_not_a_message(place: int, there: bytes) -> None:
    data = TYPES.serialize(IMAGE)
    assert struct.unpack_from("<I", data, 48)[0] == 24
    with pytest.raises(MessageError, match=f"{len(data)} bytes are not a sensor_msgs/msg/Image"):
        read_message(TYPES, data[:place] + there + data[place + len(there) :], "sensor_msgs/msg/Image")

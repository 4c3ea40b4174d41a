# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Protocol of the message classes, so that live and offline messages are built by the same code."""

from __future__ import annotations

from typing import Any, Protocol

from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.types import F64, U8

__all__ = ["NS_PER_S", "MessageTypes", "make_header", "nanoseconds", "stamp_ns"]

NS_PER_S = 10**9


class MessageTypes(Protocol):
    """Message classes of rclpy or rosbags.

    Each attribute is the class of that name, or a factory function. Messages are created with a keyword argument for
    every field, and fixed-size arrays (``k``, ``r``, ``p`` of CameraInfo) as flat float64 ndarrays, in both families.
    Sequences differ and are created by the two methods.
    """

    Time: Any
    Header: Any
    Image: Any
    CompressedImage: Any
    CameraInfo: Any
    RegionOfInterest: Any
    PointField: Any
    PointCloud2: Any
    DisparityImage: Any

    def payload(self, nbytes: int) -> tuple[Any, U8]:
        """A uint8[] field of ``nbytes`` bytes, and a writable uint8 (nbytes,) view on the same memory."""

    def float64s(self, values: F64) -> Any:
        """A float64[] field holding a copy of ``values``, float64 (N,)."""


def make_header(types: MessageTypes, stamp_ns: int, frame_id: str) -> Any:
    """A std_msgs/Header with the stamp ``stamp_ns``, integer nanoseconds."""
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return types.Header(stamp=types.Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def stamp_ns(header: Any, topic: str = "") -> int:
    """The stamp of a header of either family, integer nanoseconds; ``topic`` is the subject of errors.

    Raises:
        MessageError: as :func:`nanoseconds`.
    """
    return nanoseconds(header.stamp.sec, header.stamp.nanosec, topic)


def nanoseconds(sec: int, nanosec: int, topic: str = "") -> int:
    """Integer nanoseconds of the two fields of a stamp; ``topic`` is the subject of errors.

    Raises:
        MessageError: ``nanosec`` is a whole second or more, which no clock gives.
    """
    if not 0 <= nanosec < NS_PER_S:
        raise MessageError(
            f"nanosec = {nanosec} of the stamp is outside 0..{NS_PER_S - 1}",
            subject=topic,
            value=int(nanosec),
            limit=NS_PER_S - 1,
            remedy="the message is damaged, or the clock of its driver is wrong",
        )
    return int(sec) * NS_PER_S + int(nanosec)

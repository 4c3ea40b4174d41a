# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The factory every message is built through, so that live and offline messages have the same bytes."""

from __future__ import annotations

from typing import Any, Protocol

from stereo_depth_ros.core.types import F64, U8

__all__ = ["MessageTypes", "make_header", "stamp_ns"]

NS_PER_S = 10**9


class MessageTypes(Protocol):
    """One family of message classes and its way to fill arrays.

    Each attribute is the class of that name, or a function that makes one. Messages are made with a keyword argument
    for every field, which rclpy's classes and rosbags' dataclasses both take. Both take fixed-size arrays (``k``,
    ``r``, ``p`` of CameraInfo) as flat float64 ndarrays; sequences differ and come from the two methods.
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
    """A std_msgs/Header of the time ``stamp_ns``, integer nanoseconds."""
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return types.Header(stamp=types.Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def stamp_ns(header: Any) -> int:
    """The time of a header of any message family, integer nanoseconds."""
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message classes and their serialization without ROS, by rosbags."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from stereo_depth_ros.bags.losses import cause_text
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64, U8

__all__ = ["RosbagsTypes"]


class RosbagsTypes:
    """:class:`MessageTypes` without ROS: the dataclasses of rosbags for ROS 2 Jazzy, and their CDR bytes."""

    def __init__(self) -> None:
        self.typestore = _typestore()
        types = self.typestore.types
        self.Time: Any = types["builtin_interfaces/msg/Time"]
        self.Header: Any = types["std_msgs/msg/Header"]
        self.Image: Any = types["sensor_msgs/msg/Image"]
        self.CompressedImage: Any = types["sensor_msgs/msg/CompressedImage"]
        self.CameraInfo: Any = types["sensor_msgs/msg/CameraInfo"]
        self.RegionOfInterest: Any = types["sensor_msgs/msg/RegionOfInterest"]
        self.PointField: Any = types["sensor_msgs/msg/PointField"]
        self.PointCloud2: Any = types["sensor_msgs/msg/PointCloud2"]
        self.DisparityImage: Any = types["stereo_msgs/msg/DisparityImage"]

    def payload(self, nbytes: int) -> tuple[Any, U8]:
        """The same uint8 (nbytes,) array twice: the data field of a message and its view."""
        data = np.zeros(nbytes, np.uint8)
        return data, data

    def float64s(self, values: F64) -> Any:
        """A float64 (N,) copy of ``values``."""
        return np.array(values, np.float64).ravel()

    def serialize(self, message: Any) -> bytes:
        """The little-endian CDR bytes of a message that was created by this factory."""
        return bytes(self.typestore.serialize_cdr(message, message.__msgtype__))

    def deserialize(self, data: bytes, typename: str) -> Any:
        """The message in CDR bytes; its arrays are read-only views on ``data``.

        Args:
            data: CDR bytes with their encapsulation header.
            typename: for example "sensor_msgs/msg/Image".

        Raises:
            MessageError: unknown type, or bytes that are not a message of this type.
        """
        if typename not in self.typestore.types:
            raise MessageError(
                f"message type {quoted(typename)} is not among the {len(self.typestore.types)} known types of ROS 2 "
                "Jazzy",
                value=typename,
                remedy="register its definition in .typestore first",
            )
        try:
            return self.typestore.deserialize_cdr(data, typename)
        except Exception as error:  # those of rosbags at hostile bytes have no common base class
            raise MessageError(
                f"{len(data)} bytes are not a {typename} ({cause_text(error)})",
                value=len(data),
                remedy="check the type of the topic, or record it again",
            ) from error


@cache
def _typestore() -> Typestore:
    """One for all: it generates code for each type that it reads or writes."""
    return get_typestore(Stores.ROS2_JAZZY)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The message classes of rclpy, behind the factory that builds every message."""

from __future__ import annotations

import array
import functools
import importlib
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField, RegionOfInterest
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.messages.cdr_reader import READ_TYPES, read_message
from stereo_depth_ros.nodes.sending import Payload

__all__ = ["RclpyTypes", "message_class"]


def _keeping_data(kind: Any, *, data: Any, **fields: Any) -> Any:
    """A message that holds ``data`` itself: rclpy's constructor and its setter would copy it."""
    message = kind(**fields)
    message._data = data
    return message


def message_class(msgtype: str) -> Any:
    """The installed class of a message type such as "sensor_msgs/msg/Image"."""
    package, _, name = msgtype.rpartition("/")
    return getattr(importlib.import_module(package.replace("/", ".")), name)


class RclpyTypes:
    """MessageTypes over the installed ROS packages."""

    def __init__(self) -> None:
        self.Time: Any = Time
        self.Header: Any = Header
        self.Image: Any = functools.partial(_keeping_data, Image)
        self.CompressedImage: Any = functools.partial(_keeping_data, CompressedImage)
        self.CameraInfo: Any = CameraInfo
        self.RegionOfInterest: Any = RegionOfInterest
        self.PointField: Any = PointField
        self.PointCloud2: Any = functools.partial(_keeping_data, PointCloud2)
        self.DisparityImage: Any = DisparityImage

    def payload(self, nbytes: int) -> tuple[Any, U8]:
        """A zeroed uint8[] field and a writable uint8 (nbytes,) view on the same memory."""
        data = Payload.allocate(nbytes)
        return data, np.asarray(data)

    def float64s(self, values: F64) -> Any:
        """A float64[] field."""
        return array.array("d", values.tolist())

    def deserialize(self, data: bytes, typename: str) -> Any:
        """The message in CDR bytes; ``data`` of an image is a view on these bytes.

        Args:
            data: CDR bytes with their encapsulation header.
            typename: for example "sensor_msgs/msg/Image".

        Raises:
            MessageError: bytes that are not a message of this type.
        """
        if typename in READ_TYPES:
            return read_message(self, data, typename)
        try:
            return deserialize_message(data, message_class(typename))
        except rclpy_implementation.RMWError as error:
            raise MessageError(
                f"{len(data)} bytes are not a {typename}", value=len(data), remedy="check the type of the topic"
            ) from error

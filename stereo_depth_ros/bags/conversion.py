# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The CDR bytes of stored messages: decompressed, or converted from ROS 1 or from Foxglove's schemas."""

from __future__ import annotations

from stereo_depth_ros.bags.chunked_file import Channel, RawMessage
from stereo_depth_ros.bags.foxglove import FOXGLOVE_ENCODINGS, FOXGLOVE_TYPES, from_foxglove
from stereo_depth_ros.bags.inflate import INFLATED_LIMIT, ZSTD_MAGIC, InflationBudget, inflated, stated_size
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.errors import BagError

__all__ = ["check_convertible", "message_type", "stored_type", "to_cdr"]


def message_type(channel: Channel) -> str:
    """The type of the messages as they are read, ``package/msg/Name`` where it is one of ROS."""
    if _is_foxglove(channel):
        return FOXGLOVE_TYPES[channel.msgtype]
    package, _, name = channel.msgtype.partition("/")  # ROS 1 and the first ROS 2 bags write package/Name
    return f"{package}/msg/{name}" if name and "/" not in name else channel.msgtype


def stored_type(channel: Channel) -> str:
    """The type of the messages as they are stored, with their encoding where that is none of ROS."""
    return f"{channel.msgtype} ({channel.encoding})" if _is_foxglove(channel) else message_type(channel)


def check_convertible(types: RosbagsTypes, channel: Channel) -> None:
    """Refuses a topic whose messages cannot be converted.

    Raises:
        BagError: a type of ROS 1 that ROS 2 does not have.
    """
    if channel.encoding == "ros1" and message_type(channel) not in types.typestore.types:
        raise BagError(
            f"topic {channel.topic} of type {message_type(channel)} has no ROS 2 Jazzy equivalent",
            value=message_type(channel),
            remedy="convert the bag with rosbags-convert, or do not read the topic",
        )


def to_cdr(types: RosbagsTypes, message: RawMessage, budget: InflationBudget) -> bytes:
    """The CDR bytes of a message of a file with a budget for what is compressed.

    A message that begins with the magic of zstd is one of a recording with message compression: CDR bytes begin with 0.

    Raises:
        Exception: it is damaged; the errors of the libraries have no common base class.
    """
    channel, _, data, place = message
    if channel.encoding == "ros1":
        return bytes(types.typestore.ros1_to_cdr(data, message_type(channel)))
    if _is_foxglove(channel):
        return types.serialize(from_foxglove(types, channel.msgtype, channel.encoding, data))
    if not data.startswith(ZSTD_MAGIC):
        return data
    size = stated_size(data)
    budget.take(("message", place), INFLATED_LIMIT if size is None else size)
    return bytes(inflated(data, "zstd", size))


def _is_foxglove(channel: Channel) -> bool:
    return channel.encoding in FOXGLOVE_ENCODINGS and channel.msgtype in FOXGLOVE_TYPES

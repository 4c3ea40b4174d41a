# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sends large messages from the memory in which their payload was computed: no copy, and no interpreter lock."""

from __future__ import annotations

import array
import ctypes
import functools
import sys
from typing import Any

import numpy as np
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

from stereo_depth_ros.core.types import U8

__all__ = ["Payload", "send"]

_HEAD, _TAIL = 4096, 256  # bytes before and after a payload, for the other fields; most take fewer than 200
_ALIGNMENT = 64  # of a payload in memory; also a multiple of every alignment in CDR
_MARK = bytes(range(129, 129 + 16))  # in place of the payload; not valid UTF-8, so in no name


class Payload(np.ndarray[Any, np.dtype[np.uint8]]):
    """A uint8[] field, zeroed, with room around it for the rest of its message.

    Attributes:
        room: uint8 (N,), the memory.
        begin: where in it the payload begins.
    """

    room: U8
    begin: int

    @classmethod
    def allocate(cls, nbytes: int) -> Payload:
        """A payload of that many bytes."""
        room = np.zeros(_HEAD + _ALIGNMENT + nbytes + _TAIL, np.uint8)
        begin = _HEAD + -(room.ctypes.data + _HEAD) % _ALIGNMENT
        payload = room[begin : begin + nbytes].view(cls)
        payload.room, payload.begin = room, begin
        return payload


def send(publisher: Publisher, message: Any) -> None:
    """Publish; the memory of the message may be reused afterwards.

    rclpy's publish copies a payload twice, into a C message and from there into a serialized one, and holds the lock of
    the interpreter while the middleware copies it again. Here the other fields are serialized by rclpy, and written
    around the payload; the middleware gets the whole. The bytes sent are the same.

    Args:
        publisher: of the type of the message.
        message: one without a payload of this module, in ``data`` or ``image.data``, is published by rclpy.
    """
    holder = getattr(message, "image", message)
    payload, function = getattr(holder, "_data", None), _publish_function()
    if isinstance(payload, Payload) and function is not None:
        serialized = _serialize_around(message, holder, payload)
        if serialized is not None:
            with publisher.handle:
                if function(publisher.handle.pointer, ctypes.byref(_SerializedMessage.of(serialized)), None) == 0:
                    return
    publisher.publish(message)  # also raises what is wrong


def _serialize_around(message: Any, holder: Any, payload: Payload) -> U8 | None:
    """The serialized message, a view of the memory of its payload; None if there is not enough room."""
    mark = _MARK[: 8 + payload.size % 8]  # what follows is aligned as after the payload
    holder._data = array.array("B", mark)
    try:
        fields = serialize_message(message)
    finally:
        holder._data = payload
    at = fields.rindex(len(mark).to_bytes(4, sys.byteorder) + mark)
    head = fields[:at] + payload.size.to_bytes(4, sys.byteorder)
    tail = fields[at + 4 + len(mark) :]
    end = payload.begin + payload.size
    if len(head) > payload.begin or len(tail) > payload.room.size - end:
        return None
    payload.room[payload.begin - len(head) : payload.begin] = np.frombuffer(head, np.uint8)
    payload.room[end : end + len(tail)] = np.frombuffer(tail, np.uint8)
    return payload.room[payload.begin - len(head) : end + len(tail)]


class _SerializedMessage(ctypes.Structure):
    """rcl_serialized_message_t, that is rcutils_uint8_array_t, with its rcutils_allocator_t, which is not used."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("buffer_length", ctypes.c_size_t),
        ("buffer_capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )

    @classmethod
    def of(cls, serialized: U8) -> _SerializedMessage:
        return cls(serialized.ctypes.data, serialized.size, serialized.size)


@functools.cache
def _publish_function() -> Any:
    """rcl_publish_serialized_message of the library that rclpy has loaded; None where it is not found by its name."""
    try:
        function = ctypes.CDLL("librcl.so").rcl_publish_serialized_message
    except (OSError, AttributeError):
        return None
    function.argtypes = (ctypes.c_void_p, ctypes.POINTER(_SerializedMessage), ctypes.c_void_p)
    function.restype = ctypes.c_int
    return function

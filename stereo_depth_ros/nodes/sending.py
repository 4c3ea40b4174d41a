# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sends large messages from the memory in which their payload was computed: no copy, and no interpreter lock."""

from __future__ import annotations

import ctypes
import functools
import sys
from typing import Any

import numpy as np
from rclpy.publisher import Publisher

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.messages.cdr_fields import fields_around_payload

__all__ = ["Payload", "send"]

_HEAD, _TAIL = 4096, 256  # bytes before and after a payload, for the other fields; most take fewer than 200
_ALIGNMENT = 64  # of a payload in memory; also a multiple of every alignment in CDR


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
    the interpreter while the middleware copies it again. Here the other fields are written around the payload, and the
    middleware gets the whole.

    Args:
        publisher: of the type of the message.
        message: one without a payload of this module, in ``data`` or ``image.data``, is published by rclpy.
    """
    payload = getattr(getattr(message, "image", message), "_data", None)
    function = _publish_function()
    if isinstance(payload, Payload) and function is not None:
        serialized = _serialize_around(message, payload)
        if serialized is not None:
            with publisher.handle:
                if function(publisher.handle.pointer, ctypes.byref(_SerializedMessage.of(serialized)), None) == 0:
                    return
    publisher.publish(message)  # also raises what is wrong


def _serialize_around(message: Any, payload: Payload) -> U8 | None:
    """The serialized message, a view of the memory of its payload; None if its fields are not known or too long."""
    fields = fields_around_payload(message)
    if fields is None:
        return None
    (before, after), end = fields, payload.begin + payload.size
    if len(before) > payload.begin or len(after) > payload.room.size - end:
        return None
    payload.room[payload.begin - len(before) : payload.begin] = np.frombuffer(before, np.uint8)
    payload.room[end : end + len(after)] = np.frombuffer(after, np.uint8)
    return payload.room[payload.begin - len(before) : end + len(after)]


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
    if sys.byteorder != "little":  # as the fields and the payloads are
        return None
    try:
        function = ctypes.CDLL("librcl.so").rcl_publish_serialized_message
    except (OSError, AttributeError):
        return None
    function.argtypes = (ctypes.c_void_p, ctypes.POINTER(_SerializedMessage), ctypes.c_void_p)
    function.restype = ctypes.c_int
    return function

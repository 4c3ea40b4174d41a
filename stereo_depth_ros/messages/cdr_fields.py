# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The serialized fields before and after the payload of a large message, so that the payload itself stays in place."""

from __future__ import annotations

import struct
from typing import Any

__all__ = ["fields_around_payload"]

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # encapsulation; alignment counts from its end


def fields_around_payload(message: Any) -> tuple[bytes, bytes] | None:
    """What comes before and after the bytes of ``data``, or of ``image.data``, in the CDR of a message.

    All bytes are defined: those that align a field are 0.

    Args:
        message: an Image, CompressedImage, PointCloud2 or DisparityImage, whose ``data`` has a size.

    Returns:
        Little-endian CDR; None for another type.
    """
    name = type(message).__name__
    if name not in _WRITERS:
        return None
    writer = _Writer()
    payload = getattr(message, "image", message).data
    _WRITERS[name](writer, message, len(payload))
    return bytes(writer.before), bytes(writer.after)


class _Writer:
    """Appends fields, each aligned to its size."""

    def __init__(self) -> None:
        self.before, self.after = bytearray(_LITTLE_ENDIAN), bytearray()
        self._current, self._offset = self.before, -len(_LITTLE_ENDIAN)

    def numbers(self, kind: str, *values: float) -> None:
        """Numbers of one type of :mod:`struct`."""
        size = struct.calcsize(f"<{kind}")
        self._current += bytes(-(len(self._current) + self._offset) % size)
        self._current += struct.pack(f"<{len(values)}{kind}", *values)

    def text(self, value: str) -> None:
        encoded = value.encode() + b"\0"
        self.numbers("I", len(encoded))
        self._current += encoded

    def payload(self, size: int) -> None:
        """The length; further fields come after the payload."""
        self.numbers("I", size)
        self._current, self._offset = self.after, len(self.before) + self._offset + size

    def header(self, header: Any) -> None:
        self.numbers("i", header.stamp.sec)
        self.numbers("I", header.stamp.nanosec)
        self.text(header.frame_id)


def _image(writer: _Writer, message: Any, size: int) -> None:
    writer.header(message.header)
    writer.numbers("I", message.height, message.width)
    writer.text(message.encoding)
    writer.numbers("B", message.is_bigendian)
    writer.numbers("I", message.step)
    writer.payload(size)


def _compressed_image(writer: _Writer, message: Any, size: int) -> None:
    writer.header(message.header)
    writer.text(message.format)
    writer.payload(size)


def _point_cloud(writer: _Writer, message: Any, size: int) -> None:
    writer.header(message.header)
    writer.numbers("I", message.height, message.width, len(message.fields))
    for field in message.fields:
        writer.text(field.name)
        writer.numbers("I", field.offset)
        writer.numbers("B", field.datatype)
        writer.numbers("I", field.count)
    writer.numbers("B", message.is_bigendian)
    writer.numbers("I", message.point_step, message.row_step)
    writer.payload(size)
    writer.numbers("B", message.is_dense)


def _disparity_image(writer: _Writer, message: Any, size: int) -> None:
    writer.header(message.header)
    _image(writer, message.image, size)
    window = message.valid_window
    writer.numbers("f", message.f, message.t)
    writer.numbers("I", window.x_offset, window.y_offset, window.height, window.width)
    writer.numbers("B", window.do_rectify)
    writer.numbers("f", message.min_disparity, message.max_disparity, message.delta_d)


_WRITERS = {
    "Image": _image,
    "CompressedImage": _compressed_image,
    "PointCloud2": _point_cloud,
    "DisparityImage": _disparity_image,
}

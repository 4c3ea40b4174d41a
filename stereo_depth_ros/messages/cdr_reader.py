# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images, disparities and camera infos from the CDR bytes that a subscription receives; pixels are not copied."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.messages.types import MessageTypes

__all__ = ["READ_TYPES", "read_message"]

_ENCAPSULATION = 4  # bytes; alignment counts from their end
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # plain CDR (OMG DDSI-RTPS 2.2, 10.5)


def read_message(types: MessageTypes, data: bytes, msgtype: str) -> Any:
    """The message in its CDR bytes, of the family ``types``; ``data`` of an image is a view on these bytes.

    Middleware that takes such bytes itself drops what it cannot read without a word, or prints lines for each.

    Args:
        types: the family of messages.
        data: CDR bytes with their encapsulation.
        msgtype: one of :data:`READ_TYPES`.

    Raises:
        MessageError: bytes that are not a message of this type.
    """
    try:
        return _READERS[msgtype](types, _Reader(data))
    except (struct.error, ValueError) as error:  # an end before its time, a text that is not UTF-8
        raise MessageError(
            f"{len(data)} bytes are not a {msgtype}",
            value=len(data),
            remedy="its publisher is broken, or has another definition of the type",
        ) from error


class _Reader:
    """Reads fields, each aligned to its size; ValueError or struct.error where there are none."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self._order = _ORDERS.get(bytes(self._data[:2]), "")
        if not self._order:
            raise ValueError(f"encapsulation {quoted(bytes(self._data[:2]))} is not plain CDR")
        self._at = _ENCAPSULATION

    def numbers(self, kind: str, count: int = 1) -> tuple[Any, ...]:
        """So many numbers of one type of :mod:`struct`."""
        size = struct.calcsize(f"={kind}")
        self._at += -(self._at - _ENCAPSULATION) % size
        if count * size > len(self._data) - self._at:
            raise ValueError("a sequence ends after the message")
        values = struct.unpack_from(f"{self._order}{count}{kind}", self._data, self._at)
        self._at += count * size
        return values

    def number(self, kind: str = "I") -> Any:
        return self.numbers(kind)[0]

    def payload(self) -> memoryview:
        size = self.number()
        if size > len(self._data) - self._at:
            raise ValueError("a sequence ends after the message")
        self._at += size
        return self._data[self._at - size : self._at]

    def text(self) -> str:
        return bytes(self.payload()).partition(b"\0")[0].decode()

    def floats(self, count: int) -> F64:
        if not count:
            return np.empty(0)
        self._at += -(self._at - _ENCAPSULATION) % 8
        values = np.frombuffer(self._data, f"{self._order}f8", count, self._at)
        self._at += values.nbytes
        return values.astype(np.float64)


def _header(types: MessageTypes, reader: _Reader) -> Any:
    stamp = types.Time(sec=reader.number("i"), nanosec=reader.number())
    return types.Header(stamp=stamp, frame_id=reader.text())


def _region(types: MessageTypes, reader: _Reader) -> Any:
    x, y, height, width = reader.numbers("I", 4)
    do_rectify = bool(reader.number("B"))
    return types.RegionOfInterest(x_offset=x, y_offset=y, height=height, width=width, do_rectify=do_rectify)


def _image(types: MessageTypes, reader: _Reader) -> Any:
    header = _header(types, reader)
    height, width = reader.numbers("I", 2)
    return types.Image(
        header=header,
        height=height,
        width=width,
        encoding=reader.text(),
        is_bigendian=reader.number("B"),
        step=reader.number(),
        data=reader.payload(),
    )


def _compressed_image(types: MessageTypes, reader: _Reader) -> Any:
    return types.CompressedImage(header=_header(types, reader), format=reader.text(), data=reader.payload())


def _disparity_image(types: MessageTypes, reader: _Reader) -> Any:
    header, image = _header(types, reader), _image(types, reader)
    f, t = reader.numbers("f", 2)
    window = _region(types, reader)
    low, high, step = reader.numbers("f", 3)
    return types.DisparityImage(
        header=header,
        image=image,
        f=f,
        t=t,
        valid_window=window,
        min_disparity=low,
        max_disparity=high,
        delta_d=step,
    )


def _camera_info(types: MessageTypes, reader: _Reader) -> Any:
    header = _header(types, reader)
    height, width = reader.numbers("I", 2)
    model = reader.text()
    return types.CameraInfo(
        header=header,
        height=height,
        width=width,
        distortion_model=model,
        d=types.float64s(reader.floats(reader.number())),
        k=reader.floats(9),
        r=reader.floats(9),
        p=reader.floats(12),
        binning_x=reader.number(),
        binning_y=reader.number(),
        roi=_region(types, reader),
    )


_READERS: Mapping[str, Callable[[MessageTypes, _Reader], Any]] = {
    "sensor_msgs/msg/Image": _image,
    "sensor_msgs/msg/CompressedImage": _compressed_image,
    "sensor_msgs/msg/CameraInfo": _camera_info,
    "stereo_msgs/msg/DisparityImage": _disparity_image,
}
READ_TYPES = frozenset(_READERS)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Foxglove's images and camera calibrations, in Protocol Buffers or JSON, as messages of sensor_msgs."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from stereo_depth_ros.bags.losses import cause_text
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.types import F64

__all__ = ["FOXGLOVE_ENCODINGS", "FOXGLOVE_TYPES", "from_foxglove"]

FOXGLOVE_TYPES = {
    "foxglove.RawImage": "sensor_msgs/msg/Image",
    "foxglove.CompressedImage": "sensor_msgs/msg/CompressedImage",
    "foxglove.CameraCalibration": "sensor_msgs/msg/CameraInfo",
}
FOXGLOVE_ENCODINGS = ("protobuf", "json")
# number, name and kind of the fields; the Protocol Buffers schemas of Foxglove have never renumbered one
_FIELDS: Mapping[str, Mapping[int, tuple[str, str]]] = {
    "foxglove.RawImage": {
        1: ("timestamp", "time"),
        2: ("width", "number"),
        3: ("height", "number"),
        4: ("encoding", "text"),
        5: ("step", "number"),
        6: ("data", "bytes"),
        7: ("frame_id", "text"),
    },
    "foxglove.CompressedImage": {
        1: ("timestamp", "time"),
        2: ("data", "bytes"),
        3: ("format", "text"),
        4: ("frame_id", "text"),
    },
    "foxglove.CameraCalibration": {
        1: ("timestamp", "time"),
        2: ("width", "number"),
        3: ("height", "number"),
        4: ("distortion_model", "text"),
        5: ("D", "numbers"),
        6: ("K", "numbers"),
        7: ("R", "numbers"),
        8: ("P", "numbers"),
        9: ("frame_id", "text"),
    },
}
_EMPTY: Mapping[str, Any] = {"time": (0, 0), "number": 0, "text": "", "bytes": b"", "numbers": np.empty(0)}
_MODELS = {"kannala_brandt": "equidistant"}  # the name of the same model in ROS
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # wire types


def from_foxglove(types: RosbagsTypes, name: str, encoding: str, data: bytes) -> Any:
    """The Image, CompressedImage or CameraInfo in a message of Foxglove.

    Args:
        types: builds it.
        name: one of ``FOXGLOVE_TYPES``.
        encoding: "protobuf" or "json".
        data: the message.

    Raises:
        Exception: not such a message, or its numbers do not fit those of ROS.
    """
    try:
        fields = (_from_protobuf if encoding == "protobuf" else _from_json)(data, _FIELDS[name])
    except Exception as error:  # hostile JSON brings RecursionError and others
        raise ValueError(f"{len(data)} bytes are not a {name} of {encoding}: {cause_text(error)}") from error
    sec, nanosec = fields["timestamp"]
    if not (-(2**31) <= sec < 2**31 and 0 <= nanosec < 10**9):
        raise ValueError(f"the time {sec} s, {nanosec} ns does not fit into a stamp of ROS")
    header = types.Header(stamp=types.Time(sec=sec, nanosec=nanosec), frame_id=fields["frame_id"])
    return _BUILDERS[name](types, header, fields)


def _image(types: RosbagsTypes, header: Any, fields: Mapping[str, Any]) -> Any:
    return types.Image(
        header=header,
        height=fields["height"],
        width=fields["width"],
        encoding=fields["encoding"],
        is_bigendian=0,
        step=fields["step"],
        data=np.frombuffer(fields["data"], np.uint8),
    )


def _compressed_image(types: RosbagsTypes, header: Any, fields: Mapping[str, Any]) -> Any:
    return types.CompressedImage(header=header, format=fields["format"], data=np.frombuffer(fields["data"], np.uint8))


def _camera_info(types: RosbagsTypes, header: Any, fields: Mapping[str, Any]) -> Any:
    model = fields["distortion_model"]
    return types.CameraInfo(
        header=header,
        height=fields["height"],
        width=fields["width"],
        distortion_model=_MODELS.get(model, model),
        d=types.float64s(fields["D"]),
        k=_matrix(fields, "K", 9),
        r=_matrix(fields, "R", 9),
        p=_matrix(fields, "P", 12),
        binning_x=0,
        binning_y=0,
        roi=types.RegionOfInterest(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


_BUILDERS: Mapping[str, Callable[[RosbagsTypes, Any, Mapping[str, Any]], Any]] = {
    "foxglove.RawImage": _image,
    "foxglove.CompressedImage": _compressed_image,
    "foxglove.CameraCalibration": _camera_info,
}


def _matrix(fields: Mapping[str, Any], name: str, size: int) -> F64:
    """A matrix of ROS: zeros where it is not set."""
    values: F64 = fields[name]
    if values.size not in (0, size):
        raise ValueError(f"{name} has {values.size} numbers, not {size}")
    return values if values.size else np.zeros(size)


def _from_json(data: bytes, wanted: Mapping[int, tuple[str, str]]) -> dict[str, Any]:
    found = json.loads(data)
    if not isinstance(found, dict):
        raise ValueError("not a JSON object")
    return {
        name: _json_value(found[name], name, kind) if name in found else _EMPTY[kind] for name, kind in wanted.values()
    }


def _json_value(value: Any, name: str, kind: str) -> Any:
    if kind == "time" and isinstance(value, dict):
        return tuple(_json_value(value.get(part, 0), f"{name}.{part}", "number") for part in ("sec", "nsec"))
    if kind == "number" and type(value) is int:
        return value
    if kind == "text" and isinstance(value, str):
        return value
    if kind == "bytes" and isinstance(value, str):
        return base64.b64decode(value, validate=True)
    if kind == "numbers" and isinstance(value, list):
        return np.array(value, np.float64).ravel()
    raise ValueError(f"{name} is {json.dumps(value)[:40]}")


def _from_protobuf(data: bytes, wanted: Mapping[int, tuple[str, str]]) -> dict[str, Any]:
    """Values of the wanted fields; the last one where a field comes twice, but all of its numbers."""
    values = {name: _EMPTY[kind] for name, kind in wanted.values()}
    for number, wire_type, value in _wire_fields(memoryview(data)):
        if number not in wanted:
            continue
        name, kind = wanted[number]
        found = _protobuf_value(kind, wire_type, value)
        if found is None:
            raise ValueError(f"field {number}, {name}, has the wire type {wire_type}")
        values[name] = np.concatenate((values[name], found)) if kind == "numbers" else found
    return values


def _protobuf_value(kind: str, wire_type: int, value: Any) -> Any:
    """A value of a field; None where its wire type does not fit."""
    if kind == "number" and wire_type in (_VARINT, _FIXED32):
        return value
    if kind == "numbers" and wire_type in (_BYTES, _FIXED64):
        return np.frombuffer(value, "<f8")
    if wire_type != _BYTES:
        return None
    if kind == "time":
        parts = _from_protobuf(value, {1: ("sec", "number"), 2: ("nsec", "number")})
        return tuple(part - 2**64 * (part >= 2**63) for part in parts.values())
    return bytes(value).decode() if kind == "text" else bytes(value)


def _wire_fields(view: memoryview) -> Iterator[tuple[int, int, Any]]:
    """Number, wire type and value of each field (Protocol Buffers, Encoding)."""
    offset = 0
    while offset < len(view):
        key, offset = _varint(view, offset)
        number, wire_type = key >> 3, key & 7
        value: Any
        if wire_type == _VARINT:
            value, offset = _varint(view, offset)
            yield number, wire_type, value
            continue
        if wire_type == _BYTES:
            length, offset = _varint(view, offset)
        elif wire_type in (_FIXED32, _FIXED64):
            length = 4 if wire_type == _FIXED32 else 8
        else:
            raise ValueError(f"field {number} has the wire type {wire_type}")
        if offset + length > len(view):
            raise ValueError(f"field {number} ends after the message")
        value = view[offset : offset + length]
        offset += length
        yield number, wire_type, struct.unpack("<I", value)[0] if wire_type == _FIXED32 else value


def _varint(view: memoryview, offset: int) -> tuple[int, int]:
    """A number of 7 bits a byte, and the offset after it."""
    value = 0
    for shift in range(0, 70, 7):
        byte = view[offset]
        offset += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, offset
    raise ValueError("a number of more than 10 bytes")

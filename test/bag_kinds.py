# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The same bag in each form in which bags come: compressed, of ROS 1, of Foxglove's schemas, without metadata.yaml."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mcap.writer import Writer
from rosbags import rosbag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagMessage, BagReader

TYPES = RosbagsTypes()
# numbers of the fields in the Protocol Buffers schemas of Foxglove
_NUMBERS = {
    "RawImage": {"width": 2, "height": 3, "encoding": 4, "step": 5, "data": 6, "frame_id": 7},
    "CompressedImage": {"data": 2, "format": 3, "frame_id": 4, "message_id": 100},
    "CameraCalibration": {
        **{"width": 2, "height": 3, "distortion_model": 4, "D": 5, "K": 6, "R": 7, "P": 8, "frame_id": 9},
    },
}
_NAMES = {"Image": "RawImage", "CompressedImage": "CompressedImage", "CameraInfo": "CameraCalibration"}


def write_kind(kind: str, source: Path, folder: Path) -> Path:
    """Writes the messages of a bag in another form into an empty folder; returns what a user would name."""
    with BagReader(source) as reader:
        return KINDS[kind](list(reader.messages()), folder)


def foxglove_values(message: Any) -> dict[str, Any]:
    """The fields of a foxglove message by name, with the stamp in nanoseconds as ``stamp_ns``."""
    stamp = message.header.stamp
    values = {"stamp_ns": stamp.sec * 10**9 + stamp.nanosec, "frame_id": message.header.frame_id}
    for name in ("width", "height", "encoding", "step", "format", "distortion_model"):
        if hasattr(message, name):
            values[name] = getattr(message, name)
    for name in ("D", "K", "R", "P"):
        if hasattr(message, name.lower()):
            values[name] = getattr(message, name.lower()).tolist()
    if hasattr(message, "data"):
        values["data"] = message.data.tobytes()
    return values


def foxglove_bytes(name: str, values: dict[str, Any], encoding: str) -> bytes:
    """A message of Foxglove from its fields, see :func:`foxglove_values`."""
    values = dict(values)
    sec, nsec = divmod(values.pop("stamp_ns"), 10**9)
    if encoding == "json":
        values = {key: base64.b64encode(value).decode() if key == "data" else value for key, value in values.items()}
        return json.dumps({"timestamp": {"sec": sec, "nsec": nsec}, **values}).encode()
    time = b"".join(_varint(key) + _varint(value % 2**64) for key, value in ((1 << 3, sec), (2 << 3, nsec)) if value)
    return _sized(1, time) + b"".join(_field(_NUMBERS[name][key], value) for key, value in values.items() if value)


def _field(number: int, value: int | str | bytes | list[float]) -> bytes:
    """A field of Protocol Buffers: fixed32, string, bytes or packed doubles."""
    if isinstance(value, int):
        return _varint(number << 3 | 5) + struct.pack("<I", value)
    if isinstance(value, list):
        return _sized(number, struct.pack(f"<{len(value)}d", *value))
    return _sized(number, value.encode() if isinstance(value, str) else value)


def _sized(number: int, data: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _varint(value: int) -> bytes:
    return bytes((value & 0x7F | 0x80,)) + _varint(value >> 7) if value >= 0x80 else bytes((value,))


def _rosbag2(mode: CompressionMode, plugin: StoragePlugin, metadata: bool, bare: bool) -> Callable[..., Path]:
    def write(messages: list[BagMessage], folder: Path) -> Path:
        path = folder / "bag"
        writer = Rosbag2Writer(path, version=9, storage_plugin=plugin)
        if mode != CompressionMode.NONE:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            connections = {
                topic: writer.add_connection(topic, msgtype, typestore=TYPES.typestore)
                for topic, msgtype in _topics(messages)
            }
            for message in messages:
                writer.write(connections[message.topic], message.log_time_ns, message.data)
        if not metadata:
            (path / "metadata.yaml").unlink()
        (file,) = (file for file in path.iterdir() if file.name != "metadata.yaml")
        return file if bare else path

    return write


def _ros1(messages: list[BagMessage], folder: Path, compression: rosbag1.Writer.CompressionFormat | None) -> Path:
    path = folder / "bag.bag"
    writer = rosbag1.Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=TYPES.typestore)
            for topic, msgtype in _topics(messages)
        }
        for message in messages:
            data = TYPES.typestore.cdr_to_ros1(message.data, message.msgtype)
            writer.write(connections[message.topic], message.log_time_ns, bytes(data))
    return path


def _mcap(messages: list[BagMessage], folder: Path, encoding: str, compressed: bool = False) -> Path:
    if encoding in ("protobuf", "json"):  # Foxglove has no disparities
        messages = [message for message in messages if message.msgtype.split("/")[-1] in _NAMES]
    path = folder / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=100_000)
        writer.start(profile="ros1" if encoding == "ros1" else "")
        channels = {}
        for topic, msgtype in _topics(messages):
            package, _, name = msgtype.split("/")
            if encoding == "ros1":
                schema = writer.register_schema(f"{package}/{name}", "ros1msg", b"")
            elif encoding == "cdr":
                schema = writer.register_schema(msgtype, "ros2msg", b"")
            else:
                kind = {"protobuf": "protobuf", "json": "jsonschema"}[encoding]
                schema = writer.register_schema(f"foxglove.{_NAMES.get(name, name)}", kind, b"")
            channels[topic] = writer.register_channel(topic, encoding, schema)
        for message in messages:
            data = message.data
            if encoding == "ros1":
                data = bytes(TYPES.typestore.cdr_to_ros1(data, message.msgtype))
            elif encoding != "cdr":
                found = TYPES.deserialize(data, message.msgtype)
                data = foxglove_bytes(_NAMES[message.msgtype.split("/")[-1]], foxglove_values(found), encoding)
            writer.add_message(channels[message.topic], message.log_time_ns, data, message.log_time_ns)
        writer.finish()
    return path


def _topics(messages: list[BagMessage]) -> Iterator[tuple[str, str]]:
    return iter({message.topic: message.msgtype for message in messages}.items())


_LZ4, _BZ2 = rosbag1.Writer.CompressionFormat.LZ4, rosbag1.Writer.CompressionFormat.BZ2
_SQL, _MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
_MESSAGE, _FILE = CompressionMode.MESSAGE, CompressionMode.FILE
KINDS: dict[str, Callable[[list[BagMessage], Path], Path]] = {
    "messages compressed, .mcap": _rosbag2(_MESSAGE, _MCAP, False, True),
    "messages compressed, .db3": _rosbag2(_MESSAGE, _SQL, False, True),
    "messages compressed, folder of .mcap": _rosbag2(_MESSAGE, _MCAP, False, False),
    "messages compressed, folder of .db3": _rosbag2(_MESSAGE, _SQL, False, False),
    "messages compressed, metadata": _rosbag2(_MESSAGE, _SQL, True, False),
    ".mcap.zstd": _rosbag2(_FILE, _MCAP, False, True),
    ".db3.zstd": _rosbag2(_FILE, _SQL, False, True),
    "folder of .mcap.zstd": _rosbag2(_FILE, _MCAP, False, False),
    "folder of .db3.zstd": _rosbag2(_FILE, _SQL, False, False),
    "files compressed, metadata": _rosbag2(_FILE, _MCAP, True, False),
    ".bag": lambda messages, folder: _ros1(messages, folder, None),
    ".bag of lz4": lambda messages, folder: _ros1(messages, folder, _LZ4),
    ".bag of bz2": lambda messages, folder: _ros1(messages, folder, _BZ2),
    "mcap of ros1": lambda messages, folder: _mcap(messages, folder, "ros1"),
    "foxglove, protobuf": lambda messages, folder: _mcap(messages, folder, "protobuf"),
    "foxglove, json": lambda messages, folder: _mcap(messages, folder, "json"),
}

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Opens the files of a bag, of any format and compression."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import zstandard
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection
from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.recovery import RecoveredMcap
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.safe_yaml import load_yaml
from stereo_depth_ros.core.text_files import read_text

__all__ = ["BagSource", "bag_files", "is_bag", "open_sources"]

_ROSBAG2_KINDS = (".mcap", ".db3")
_KINDS = "an .mcap, .db3 or .bag file or a rosbag2 folder"


class BagSource(Protocol):
    """One file of a bag; ``topics`` gives message type and number of messages per topic."""

    start_ns: int
    end_ns: int

    @property
    def topics(self) -> dict[str, tuple[str, int]]: ...

    def messages(self, topics: set[str], start_ns: int, end_ns: int) -> Iterator[tuple[str, int, bytes]]: ...

    def close(self) -> None: ...


def is_bag(path: Path) -> bool:
    """Whether a path is a bag by its name: an .mcap, .db3 or .bag file, or a folder with .mcap or .db3 files.

    The files may be compressed as a whole, which adds ``.zstd``. What is in them is not read.
    """
    if path.is_dir():
        return any(_kind(file) in _ROSBAG2_KINDS for file in path.iterdir())
    return path.is_file() and _kind(path) in (*_ROSBAG2_KINDS, ".bag")


def open_sources(path: Path, types: RosbagsTypes, stack: ExitStack) -> list[BagSource]:
    """The files of a bag, opened; ``stack`` closes them.

    Raises:
        BagError: the path does not exist, is not a bag, is empty, or cannot be read.
    """
    if not path.exists():
        raise BagError("does not exist", subject=str(path), remedy=f"give {_KINDS}")
    if not path.is_dir():
        return [_open_file(path, types, stack, packed_messages=False)]
    # rosbags compares the QoS of metadata.yaml with that of the files and skips messages where they differ, so each
    # file is opened separately, and metadata.yaml gives the file names and the compression only
    metadata = _read_metadata(path / "metadata.yaml")
    files = [path / Path(name).name for name in metadata.get("relative_file_paths") or []]
    if missing := [file.name for file in files if not file.exists()]:
        raise BagError(
            f"lacks {', '.join(missing)}, which its metadata.yaml lists",
            subject=str(path),
            value=missing,
            remedy="copy the whole folder",
        )
    files = files or sorted(file for file in path.iterdir() if _kind(file) in _ROSBAG2_KINDS)
    if not files:
        raise BagError("is not a bag, it holds no .mcap or .db3 file", subject=str(path), remedy=f"give {_KINDS}")
    packed_messages = str(metadata.get("compression_mode") or "").lower() == "message"
    return [_open_file(file, types, stack, packed_messages=packed_messages) for file in files]


def bag_files(path: Path) -> list[Path]:
    """Every file of a bag: itself, or all files of its folder."""
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


class _RosbagsSource:
    """A file that rosbags opens; ROS 1 messages are converted to CDR, compressed messages decompressed."""

    def __init__(self, path: Path, types: RosbagsTypes, packed_messages: bool) -> None:
        self._types = types
        self._packed = packed_messages
        self._ros1 = path.suffix == ".bag"
        self._reader = rosbag1.Reader(path) if self._ros1 else rosbag2.Reader(path)
        self._reader.open()
        self.start_ns = self._reader.start_time
        self.end_ns = self._reader.end_time - 1  # rosbags gives the nanosecond after the last message

    @property
    def topics(self) -> dict[str, tuple[str, int]]:
        topics = self._reader.topics.items()
        return {name: (info.msgtype or "", info.msgcount) for name, info in topics}

    def messages(self, topics: set[str], start_ns: int, end_ns: int) -> Iterator[tuple[str, int, bytes]]:
        connections = [connection for connection in self._reader.connections if connection.topic in topics]
        if not connections:  # rosbags reads all topics of an empty list
            return
        for connection, log_time_ns, data in self._reader.messages(connections, start_ns, end_ns + 1):
            yield connection.topic, log_time_ns, self._cdr(connection, data)

    def close(self) -> None:
        self._reader.close()

    def _cdr(self, connection: Connection, data: bytes) -> bytes:
        if self._packed:
            return zstandard.ZstdDecompressor().decompressobj().decompress(data)
        if not self._ros1:
            return bytes(data)
        try:
            return bytes(self._types.typestore.ros1_to_cdr(data, connection.msgtype))
        except (KeyError, SerdeError, TypesysError) as error:
            raise BagError(
                f"topic {connection.topic} of type {connection.msgtype} has no ROS 2 Jazzy equivalent",
                value=connection.msgtype,
                remedy="convert the bag with rosbags-convert, or do not read the topic",
            ) from error


def _open_file(path: Path, types: RosbagsTypes, stack: ExitStack, *, packed_messages: bool) -> BagSource:
    if _kind(path) not in (*_ROSBAG2_KINDS, ".bag"):
        raise BagError("is not a bag", subject=str(path), remedy=f"give {_KINDS}")
    if not path.stat().st_size:
        raise BagError("is empty (0 bytes)", subject=str(path), value=0, remedy="record it again")
    file = _unpack(path, stack) if path.suffix == ".zstd" else path
    source: BagSource
    try:
        source = _RosbagsSource(file, types, packed_messages)
    except Exception as error:  # those of rosbags and of what it reads with have no common base class
        if file.suffix != ".mcap" or packed_messages:
            raise BagError(f"is cut or damaged ({error})", subject=str(path), remedy=_remedy(file)) from error
        source = RecoveredMcap(file)
    stack.callback(source.close)
    return source


def _kind(path: Path) -> str:
    """The file suffix, ignoring a trailing .zstd."""
    return Path(path.stem).suffix if path.suffix == ".zstd" else path.suffix


def _unpack(path: Path, stack: ExitStack) -> Path:
    folder = stack.enter_context(TemporaryDirectory())
    unpacked = Path(folder, path.stem)
    try:
        with path.open("rb") as source, unpacked.open("wb") as target:
            shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(source), target)
    except (OSError, zstandard.ZstdError) as error:
        raise BagError(f"cannot be decompressed ({error})", subject=str(path), remedy="copy it again") from error
    return unpacked


def _remedy(path: Path) -> str:
    if path.suffix == ".db3":
        return f"recover it with `sqlite3 {path.name} .recover | sqlite3 new.db3`"
    return "recover it with `rosbag reindex`" if path.suffix == ".bag" else "record it again"


def _read_metadata(path: Path) -> dict[str, Any]:
    """The contents of metadata.yaml; empty where it is missing or damaged, as after a crash of the recorder."""
    try:
        return dict(load_yaml(read_text(path, BagError, "copy it again"))["rosbag2_bagfile_information"])
    except (BagError, KeyError, TypeError, ValueError):
        return {}

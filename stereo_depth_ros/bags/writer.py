# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes MCAP bags that rosbag2 and Foxglove read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer
from rosbags.typesys import TypesysError

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.files.output import OutputFile, as_output_errors, check_outputs

__all__ = ["BagWriter", "check_bag_output"]

_COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


_FOREVER = "{sec: 9223372036, nsec: 854775807}"
# keep last, depth 1, reliable, transient local, as numbers of rmw like in the metadata of rosbag2
_LATCHED = f"""\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {_FOREVER}
  lifespan: {_FOREVER}
  liveliness: 1
  liveliness_lease_duration: {_FOREVER}
  avoid_ros_namespace_conventions: false
"""


class BagWriter:
    """One MCAP file, profile ``ros2``: CDR messages, ``ros2msg`` schemas with every nested definition.

    The bag appears under its name when it is complete; when the ``with`` block ends in an exception, nothing does.

    Args:
        path: file to create, must end in ``.mcap``; missing folders are created.
        compression: compression of the chunks: "zstd", "lz4" or "none".
        chunk_size: bytes of messages per chunk before compression; about this much is lost if the process is killed.
        overwrite: replace an existing file.

    Raises:
        BagError: wrong suffix, or unknown compression.
        OutputError: an existing file without ``overwrite``, or it cannot be created.
    """

    def __init__(
        self, path: Path, *, compression: str = "zstd", chunk_size: int = 4 * 1024 * 1024, overwrite: bool = False
    ) -> None:
        if compression not in _COMPRESSIONS:
            raise BagError(
                f"compression {compression!r} is not one of {', '.join(_COMPRESSIONS)}",
                value=compression,
                limit=tuple(_COMPRESSIONS),
                remedy="choose one of them",
                settings=("compression",),
            )
        _check_name(path)
        self.path = path
        self.message_count = 0
        self._types = RosbagsTypes()
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, tuple[str, int]] = {}
        self._sequences: dict[int, int] = {}
        self._output = OutputFile(path, overwrite=overwrite, make_folders=True)
        self._writer = Writer(self._output.file, chunk_size=chunk_size, compression=_COMPRESSIONS[compression])
        with as_output_errors(path):
            self._writer.start(profile="ros2", library="stereo_depth_ros")

    def write_raw(
        self,
        topic: str,
        msgtype: str,
        cdr: bytes,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        latched: bool = False,
    ) -> None:
        """Write a serialized message; without ``publish_time_ns`` it is published at its log time.

        A topic whose first message is ``latched`` is recorded as transient local: late subscribers receive it too.

        Raises:
            BagError: the type has no known definition, or the topic already carries another type.
            OutputError: it cannot be written.
        """
        channel = self._channel(topic, msgtype, latched)
        sequence = self._sequences[channel] = self._sequences.get(channel, 0) + 1
        publish_time = log_time_ns if publish_time_ns is None else publish_time_ns
        with as_output_errors(self.path):
            self._writer.add_message(channel, log_time_ns, cdr, publish_time, sequence)
        self.message_count += 1

    def write(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Serialize and write a rosbags message object, logged at ``stamp_ns``."""
        self.write_raw(topic, message.__msgtype__, self._types.serialize(message), stamp_ns)

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record: names and values, such as the parameters that were used."""
        with as_output_errors(self.path):
            self._writer.add_metadata(name, dict(values))

    def close(self) -> None:
        """Finish the bag and give it its name; a second call does nothing.

        Raises:
            OutputError: it cannot be written completely, or a file of this name has been created in the meantime.
        """
        if self._output.file.closed:
            return
        with self._output, as_output_errors(self.path):
            self._writer.finish()  # type: ignore[no-untyped-call]

    def discard(self) -> None:
        """Close and remove the unfinished bag."""
        self._output.discard()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def _channel(self, topic: str, msgtype: str, latched: bool) -> int:
        if topic not in self._channels:
            schema = self._schema(msgtype)
            # rosbag2 reads both keys; without a QoS profile it plays with its default
            metadata = {
                "offered_qos_profiles": _LATCHED if latched else "",
                "topic_type_hash": self._types.typestore.hash_rihs01(msgtype),
            }
            self._channels[topic] = (msgtype, self._writer.register_channel(topic, "cdr", schema, metadata))
        known_type, channel = self._channels[topic]
        if known_type != msgtype:
            raise BagError(
                f"topic {topic} carries {known_type}, not {msgtype}",
                value=msgtype,
                limit=known_type,
                remedy=f"write {msgtype} on another topic",
            )
        return channel

    def _schema(self, msgtype: str) -> int:
        if msgtype not in self._schemas:
            try:
                definition, _ = self._types.typestore.generate_msgdef(msgtype, ros_version=2)
            except TypesysError as error:
                raise BagError(
                    f"no definition of message type {msgtype!r}",
                    subject=str(self.path),
                    value=msgtype,
                    remedy="write types of ROS 2 Jazzy only",
                ) from error
            self._schemas[msgtype] = self._writer.register_schema(msgtype, "ros2msg", definition.encode())
        return self._schemas[msgtype]


def check_bag_output(
    path: Path,
    inputs: Iterable[Path],
    *,
    more: Iterable[Path | None] = (),
    reports: Iterable[Path | None] = (),
    overwrite: bool = False,
) -> None:
    """:func:`check_outputs` for one bag, and ``more`` outputs beside it; None is ignored.

    Raises:
        BagError: wrong suffix.
        OutputError: it must not or cannot be written.
    """
    _check_name(path)
    outputs = [path, *(each for each in more if each is not None)]
    check_outputs(outputs, inputs, reports=reports, overwrite=overwrite)


def _check_name(path: Path) -> None:
    if path.suffix != ".mcap":
        raise BagError(
            "cannot be written, bags are written as MCAP and it does not end in .mcap",
            subject=str(path),
            value=path.suffix,
            limit=".mcap",
            remedy=f"name it {path.stem}.mcap",
        )

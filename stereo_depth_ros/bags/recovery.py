# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads an MCAP file that has no index, such as one cut in the middle: every whole message before the cut."""

from __future__ import annotations

import heapq
import io
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from stereo_depth_ros.core.errors import BagError

__all__ = ["RecoveredMcap"]

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER = struct.Struct("<BQ")
_DAMAGE = (McapError, struct.error, UnicodeDecodeError, zstandard.ZstdError, RuntimeError)  # lz4 raises RuntimeError
_CHUNK_HEADER = struct.Struct("<QQQII")  # start, end, uncompressed size, CRC, length of the compression's name


class _Record(NamedTuple):
    opcode: int
    offset: int
    content: bytes
    complete: bool


@dataclass(frozen=True)
class _Block:
    """A chunk, or one message outside of chunks: where it is and the first time in it."""

    offset: int
    start_ns: int


class RecoveredMcap:
    """A sequential scan makes the index that the file lacks; messages are then read block by block in log-time order.

    Attributes:
        cut: the file ends, or is damaged, before its footer.
        start_ns, end_ns: log times of the first and last message; 0 when there is none.

    Raises:
        BagError: not an MCAP file, or compressed in an unknown way.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cut = True
        self.start_ns = self.end_ns = 0
        self._file = path.open("rb")
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()
        self._blocks: list[_Block] = []
        try:
            self._scan()
        except BaseException:
            self._file.close()
            raise

    @property
    def topics(self) -> dict[str, tuple[str, int]]:
        """Message type and number of messages per topic."""
        topics: dict[str, tuple[str, int]] = {}
        for channel in self._channels.values():
            schema = self._schemas.get(channel.schema_id)
            count = topics.get(channel.topic, ("", 0))[1] + self._counts[channel.id]
            topics[channel.topic] = (schema.name if schema else "", count)
        return topics

    def messages(self, topics: set[str], start_ns: int, end_ns: int) -> Iterator[tuple[str, int, bytes]]:
        """(topic, log time, CDR bytes) with start_ns <= log time <= end_ns, in log-time order."""
        ids = {key: channel.topic for key, channel in self._channels.items() if channel.topic in topics}
        # a block waits in the queue until its first message is due, then its messages take its place
        queue: list[tuple[int, int, int, _Block | Message]] = [
            (block.start_ns, block.offset, 0, block) for block in self._blocks if block.start_ns <= end_ns
        ]
        heapq.heapify(queue)
        while queue:
            log_time, offset, _, item = heapq.heappop(queue)
            if isinstance(item, Message):
                yield ids[item.channel_id], log_time, item.data
                continue
            for index, message in enumerate(self._block_messages(item)):
                if message.channel_id in ids and start_ns <= message.log_time <= end_ns:
                    heapq.heappush(queue, (message.log_time, offset, index + 1, message))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _scan(self) -> None:
        if self._file.read(len(_MAGIC)) != _MAGIC:
            raise BagError(f"{self.path} is not an MCAP file: it does not begin with the MCAP magic")
        for record in _records(self._file):
            if record.opcode in (Opcode.DATA_END, Opcode.FOOTER) and record.complete:
                self.cut = False
                return
            try:
                messages = list(self._read(record))
            except _DAMAGE:
                return  # what follows a damaged record cannot be trusted: the same as a cut in front of it
            if messages:
                self._index(record.offset, messages)

    def _index(self, offset: int, messages: list[Message]) -> None:
        self._counts.update(message.channel_id for message in messages)
        first = min(message.log_time for message in messages)
        last = max(message.log_time for message in messages)
        self.start_ns = min(self.start_ns, first) if self._blocks else first
        self.end_ns = max(self.end_ns, last)
        self._blocks.append(_Block(offset, first))

    def _read(self, record: _Record) -> Iterator[Message]:
        """The messages of a top-level record; learns schemas and channels on the way."""
        inner = iter([record]) if record.opcode != Opcode.CHUNK else _records(io.BytesIO(_unpack(record.content)))
        for item in inner:
            if not item.complete:
                return
            stream = ReadDataStream(io.BytesIO(item.content))
            if item.opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
            elif item.opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                self._channels[channel.id] = channel
            elif item.opcode == Opcode.MESSAGE:
                yield Message.read(stream, len(item.content))

    def _block_messages(self, block: _Block) -> Iterator[Message]:
        self._file.seek(block.offset)
        return self._read(next(_records(self._file)))


def _records(stream: BinaryIO) -> Iterator[_Record]:
    """Records until the stream ends; the last one may be incomplete."""
    offset = stream.tell()
    size = stream.seek(0, io.SEEK_END)
    while offset + _RECORD_HEADER.size <= size:
        stream.seek(offset)
        opcode, length = _RECORD_HEADER.unpack(stream.read(_RECORD_HEADER.size))
        if opcode == 0:  # never valid: zeros that a file system left behind after a power cut
            return
        offset += _RECORD_HEADER.size
        content = stream.read(min(length, size - offset))
        yield _Record(opcode, offset - _RECORD_HEADER.size, content, len(content) == length)
        offset += length


def _unpack(content: bytes) -> bytes:
    """The records of a chunk; a cut chunk gives those at its beginning."""
    if len(content) < _CHUNK_HEADER.size:
        return b""
    name_end = _CHUNK_HEADER.size + _CHUNK_HEADER.unpack_from(content)[4]
    compression = content[_CHUNK_HEADER.size : name_end].decode()
    data = content[name_end + 8 :]
    if compression == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data))
    if compression:
        raise BagError(f"chunk compression {compression!r} is not known: known are zstd, lz4 and none")
    return data

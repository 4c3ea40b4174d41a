# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads an MCAP file without index, such as one that is cut: every complete message before the cut."""

from __future__ import annotations

import heapq
import io
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.quoted import quoted

__all__ = ["RecoveredMcap"]

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER = struct.Struct("<BQ")
# raised by mcap at damaged records, by zstandard and lz4 (RuntimeError) at damaged chunks
_DAMAGE = (McapError, struct.error, UnicodeDecodeError, OverflowError, zstandard.ZstdError, RuntimeError)
_READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)


class _Record(NamedTuple):
    """A top-level record; ``data`` begins with its opcode and length."""

    opcode: int
    offset: int
    data: bytes
    complete: bool


@dataclass(frozen=True)
class _Block:
    """A chunk, or one message outside of chunks: its offset in the file and its first log time."""

    offset: int
    start_ns: int


class RecoveredMcap:
    """A sequential scan builds the index that the file lacks; messages are read block by block in log-time order.

    Attributes:
        cut: the file ends, or is damaged, before its footer.
        start_ns, end_ns: log times of the first and last message; 0 when there is none.

    Raises:
        BagError: not an MCAP file, or of an unsupported compression.
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
        # a block stays in the queue until its first message is due, then its messages replace it
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
            raise BagError(
                "is not an MCAP file, it does not begin with the MCAP magic",
                subject=str(self.path),
                remedy="check what the file is, or copy it again",
            )
        with suppress(*_DAMAGE):  # treat a damaged record as the end of the file
            for record in _top_level_records(self._file):
                if record.opcode in (Opcode.DATA_END, Opcode.FOOTER) and record.complete:
                    self.cut = False
                    return
                if messages := list(self._read(record)):
                    self._index(record.offset, messages)

    def _index(self, offset: int, messages: list[Message]) -> None:
        self._counts.update(message.channel_id for message in messages)
        first = min(message.log_time for message in messages)
        last = max(message.log_time for message in messages)
        self.start_ns = min(self.start_ns, first) if self._blocks else first
        self.end_ns = max(self.end_ns, last)
        self._blocks.append(_Block(offset, first))

    def _read(self, record: _Record) -> Iterator[Message]:
        """The messages of a top-level record; stores the schemas and channels in it."""
        if record.opcode == Opcode.CHUNK:
            data = _unpack(Chunk.read(ReadDataStream(io.BytesIO(record.data[_RECORD_HEADER.size :]))))
        else:
            data = record.data if record.opcode in _READ else b""
        with suppress(EndOfFile, struct.error):  # at the end of the data, or where it is cut
            for item in StreamReader(io.BytesIO(data), skip_magic=True).records:
                if isinstance(item, Schema):
                    self._schemas[item.id] = item
                elif isinstance(item, Channel):
                    self._channels[item.id] = item
                elif isinstance(item, Message):
                    yield item

    def _block_messages(self, block: _Block) -> Iterator[Message]:
        self._file.seek(block.offset)
        return self._read(next(_top_level_records(self._file)))


def _top_level_records(file: BinaryIO) -> Iterator[_Record]:
    """Records until the file ends; the last one may be incomplete.

    mcap's StreamReader does not serve here: it gives complete records only and loses the messages at the beginning of a
    cut chunk, parses every record and ends at a damaged index, and allocates whatever a damaged length states.
    """
    offset = file.tell()
    size = file.seek(0, io.SEEK_END)
    while offset + _RECORD_HEADER.size <= size:
        file.seek(offset)
        header = file.read(_RECORD_HEADER.size)
        opcode, length = _RECORD_HEADER.unpack(header)
        if opcode == 0:  # never valid: zeros that a file system left behind after a power cut
            return
        end = offset + _RECORD_HEADER.size + length
        yield _Record(opcode, offset, header + file.read(min(length, size)), end <= size)
        offset = end


def _unpack(chunk: Chunk) -> bytes:
    """The records of a chunk; for a truncated chunk, the records at its beginning (mcap needs complete chunks)."""
    if chunk.compression == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
    if chunk.compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data))
    if chunk.compression:
        raise BagError(
            f"chunk compression {quoted(chunk.compression)} is not supported, supported are zstd, lz4 and none",
            value=chunk.compression,
            limit=("zstd", "lz4", "none"),
            remedy="convert the bag to one of these",
        )
    return chunk.data

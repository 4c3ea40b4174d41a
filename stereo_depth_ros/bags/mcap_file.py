# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads MCAP files by their index, or, where it is missing or damaged, by a scan up to where the file ends."""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from collections.abc import Container, Iterator
from contextlib import suppress
from typing import Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, Footer, MessageIndex, Schema, Statistics

from stereo_depth_ros.bags.chunked_file import Channel, Chunk, ChunkedFile, StoredMessage
from stereo_depth_ros.bags.inflate import check_size, inflated, inflated_start
from stereo_depth_ros.bags.losses import cause_text
from stereo_depth_ros.core.errors import BagError

__all__ = ["McapFile"]

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER = struct.Struct("<BQ")  # opcode, length
_CHUNK_HEADER = struct.Struct("<QQQII")  # first and last log time, size, CRC, length of the name of the compression
_MESSAGE_HEADER = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_LENGTH = struct.Struct("<Q")
_FOOTER_BYTES = _RECORD_HEADER.size + 20 + len(_MAGIC)


class _Record(NamedTuple):
    """A record in the file: its opcode, where its content begins and how long it should be."""

    opcode: int
    offset: int
    length: int
    complete: bool

    @property
    def content(self) -> int:
        return self.offset + _RECORD_HEADER.size


class McapFile(ChunkedFile):
    """An MCAP file, chunked or not, indexed or not, complete or cut.

    Chunks are checked by their CRC where they have one. A file without index is scanned; where the scan meets what is
    not a record, the file is cut.

    Raises:
        BagError: not an MCAP file.
    """

    def _open(self) -> None:
        self._size = self._file.seek(0, io.SEEK_END)
        self._file.seek(0)
        begins = self._file.read(len(_MAGIC)) == _MAGIC
        footer = self._content(max(self._size - _FOOTER_BYTES, 0), _FOOTER_BYTES)
        if not begins and not footer.endswith(_MAGIC):
            raise BagError(
                "is not an MCAP file, it does not begin with the MCAP magic",
                subject=str(self.path),
                remedy="check what the file is, or copy it again",
            )
        try:
            summary, is_checked = self._summary(footer)
            index = _Index(summary)
            if index.is_complete and (is_checked or self._holds(index.chunks)):
                self.channels, self.chunks = index.channels, index.chunks
                return
        except Exception:  # the errors of the parser have no common base class; a scan needs no index
            pass
        self._scan()

    def _read(self, chunk: Chunk, wanted: Container[int]) -> Iterator[StoredMessage]:
        record = self._record_at(chunk.offset)
        if record.opcode not in (Opcode.CHUNK, Opcode.MESSAGE):
            raise ValueError(f"a record {record.opcode} is where it should be")
        for opcode, content in self._contents(record):
            if opcode == Opcode.MESSAGE:
                channel, _, log_time_ns, _ = _MESSAGE_HEADER.unpack_from(content)
                if channel in wanted:
                    yield StoredMessage(channel, log_time_ns, bytes(content[_MESSAGE_HEADER.size :]))

    def _summary(self, footer: bytes) -> tuple[bytes, bool]:
        """The summary section, and whether it has a CRC.

        Raises:
            ValueError: none, or its CRC is wrong.
        """
        opcode, length = _RECORD_HEADER.unpack_from(footer)
        if not footer.endswith(_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
            raise ValueError("no footer")
        found: Footer = _parsed(Footer, footer[_RECORD_HEADER.size :])
        start, end = found.summary_start, self._size - _FOOTER_BYTES
        if not len(_MAGIC) <= start < end:
            raise ValueError("no summary")
        summary = self._content(start, end - start)
        crc = zlib.crc32(footer[: _RECORD_HEADER.size + 16], zlib.crc32(summary))
        if found.summary_crc not in (0, crc):
            raise ValueError("damaged summary")
        return summary, bool(found.summary_crc)

    def _holds(self, chunks: list[Chunk]) -> bool:
        """Whether all chunks of an index are where it says."""
        return all(self._record_at(chunk.offset).opcode == Opcode.CHUNK for chunk in chunks)

    def _scan(self) -> None:
        """Finds the chunks and messages that are outside of chunks, from the beginning of the file."""
        schemas: dict[int, str] = {}
        channels: dict[int, McapChannel] = {}
        damaged: list[tuple[int, Counter[int], str]] = []
        last_is_damaged = False
        self.cut = True
        for record in self._records():
            if record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                self.cut = self.cut and not record.complete  # a summary may follow, which repeats the channels
                continue
            if record.opcode == Opcode.MESSAGE_INDEX and last_is_damaged and record.complete:
                with suppress(Exception):  # an index that is damaged too tells nothing
                    index: MessageIndex = _parsed(MessageIndex, self._content(record.content, record.length))
                    damaged[-1][1][index.channel_id] += len(index.records)
                continue
            try:
                last_is_damaged = False
                self._scan_record(record, schemas, channels)
            except Exception as error:  # of the parser and of the libraries that decompress
                if record.opcode in (Opcode.CHUNK, Opcode.MESSAGE) and record.complete:
                    damaged.append((record.offset, Counter(), cause_text(error)))
                    last_is_damaged = record.opcode == Opcode.CHUNK
        self.channels = _channels(schemas, channels)
        for offset, counts, cause in damaged:
            self._counts.update(counts)
            self.losses.add_chunk((self.path, offset), self.by_topic(counts), cause)

    def _scan_record(self, record: _Record, schemas: dict[int, str], channels: dict[int, McapChannel]) -> None:
        counts: Counter[int] = Counter()
        start_ns, end_ns = 2**64, -1
        try:
            for opcode, content in self._contents(record):
                _note_description(opcode, content, schemas, channels)
                if opcode == Opcode.MESSAGE:
                    key, _, log_time_ns, _ = _MESSAGE_HEADER.unpack_from(content)
                    counts[key] += 1
                    start_ns, end_ns = min(start_ns, log_time_ns), max(end_ns, log_time_ns)
        except Exception:  # the messages at the beginning of a chunk that is cut are all there is
            if record.complete:
                raise
        if counts:
            self.chunks.append(Chunk(record.offset, start_ns, end_ns, counts, cut=not record.complete))

    def _records(self) -> Iterator[_Record]:
        """Top-level records until the file ends or holds no record; the last one may be incomplete."""
        offset = len(_MAGIC)
        while offset + _RECORD_HEADER.size <= self._size:
            record = self._record_at(offset)
            if record.opcode == 0:  # never valid: zeros that a file system left behind after a power cut
                return
            yield record
            offset = record.content + record.length

    def _record_at(self, offset: int) -> _Record:
        opcode, length = _RECORD_HEADER.unpack(self._content(offset, _RECORD_HEADER.size))
        return _Record(opcode, offset, length, offset + _RECORD_HEADER.size + length <= self._size)

    def _content(self, offset: int, length: int) -> bytes:
        """At most ``length`` bytes of the file; never allocates more than it has."""
        self._file.seek(offset)
        return self._file.read(min(length, max(self._size - offset, 0)))

    def _contents(self, record: _Record) -> Iterator[tuple[int, memoryview]]:
        """Opcode and content of the records in a chunk, or of a record outside of chunks."""
        if record.opcode == Opcode.CHUNK:
            yield from self._chunk_records(record)
        elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE) and record.complete:
            check_size(record.length)
            yield record.opcode, memoryview(self._content(record.content, record.length))

    def _chunk_records(self, record: _Record) -> Iterator[tuple[int, memoryview]]:
        check_size(min(record.length, self._size - record.content))
        content = self._content(record.content, record.length)
        _, _, size, crc, name_length = _CHUNK_HEADER.unpack_from(content)
        start = _CHUNK_HEADER.size + name_length + _LENGTH.size
        compression = content[_CHUNK_HEADER.size : start - _LENGTH.size].decode()
        (length,) = _LENGTH.unpack_from(content, start - _LENGTH.size)
        packed = content[start : start + length]
        self.budget.take(record.offset, size)
        if not record.complete:
            yield from self.budget.counted(record.offset, _split(inflated_start(packed, compression, size)))
            return
        data = inflated(packed, compression, size)
        if crc and crc != zlib.crc32(data):
            raise ValueError(f"its CRC is {zlib.crc32(data):08x}, not {crc:08x}")
        yield from self.budget.counted(record.offset, _split(data))


class _Index:
    """The summary section: channels, chunks, and whether they are all there is."""

    def __init__(self, summary: bytes) -> None:
        schemas: dict[int, str] = {}
        channels: dict[int, McapChannel] = {}
        chunks: list[ChunkIndex] = []
        statistics: Statistics | None = None
        for opcode, content in _split(summary):
            _note_description(opcode, content, schemas, channels)
            if opcode == Opcode.CHUNK_INDEX:
                chunks.append(_parsed(ChunkIndex, content))
            elif opcode == Opcode.STATISTICS:
                statistics = _parsed(Statistics, content)
        self.channels = _channels(schemas, channels)
        self.chunks = [  # one without indexed messages has none
            Chunk(chunk.chunk_start_offset, chunk.message_start_time, chunk.message_end_time, _counts(chunk))
            for chunk in chunks
            if chunk.message_index_offsets
        ]
        counts = sum((Counter(chunk.counts) for chunk in self.chunks), Counter[int]())
        # messages outside of chunks are not indexed, nor need those in chunks be, and channels need not be repeated
        self.is_complete = (
            statistics is not None
            and (statistics.message_count, statistics.chunk_count) == (sum(counts.values()), len(chunks))
            and counts.keys() <= self.channels.keys()
            and all(channel.schema_id in schemas or not channel.schema_id for channel in channels.values())
        )


def _note_description(
    opcode: int, content: bytes | memoryview, schemas: dict[int, str], channels: dict[int, McapChannel]
) -> None:
    """Adds the name of a schema, or a channel; nothing of another record."""
    if opcode == Opcode.SCHEMA:
        schema: Schema = _parsed(Schema, content)
        schemas[schema.id] = schema.name
    elif opcode == Opcode.CHANNEL:
        channel: McapChannel = _parsed(McapChannel, content)
        channels[channel.id] = channel


def _channels(schemas: dict[int, str], channels: dict[int, McapChannel]) -> dict[int, Channel]:
    return {
        key: Channel(channel.topic, schemas.get(channel.schema_id, ""), channel.message_encoding)
        for key, channel in channels.items()
    }


def _counts(chunk: ChunkIndex) -> dict[int, int]:
    """Messages of a chunk by channel, from the lengths of its message indices, which follow each other."""
    starts = sorted((offset, channel) for channel, offset in chunk.message_index_offsets.items())
    ends = [offset for offset, _ in starts[1:]]
    ends.append(chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length)
    header = _RECORD_HEADER.size + 6  # channel, and the length of the entries of 16 bytes
    counts = {channel: (end - start - header) // 16 for (start, channel), end in zip(starts, ends, strict=True)}
    if any(count < 0 for count in counts.values()):
        raise ValueError("message indices overlap")
    return {channel: count for channel, count in counts.items() if count}


def _split(data: bytes | bytearray) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of the records in data.

    Raises:
        ValueError: the last one is incomplete.
    """
    view, offset = memoryview(data), 0
    while offset + _RECORD_HEADER.size <= len(data):
        opcode, length = _RECORD_HEADER.unpack_from(data, offset)
        start = offset + _RECORD_HEADER.size
        offset = start + length
        if offset > len(data):
            break
        yield opcode, view[start:offset]
    if offset != len(data):
        raise ValueError("a record in it is incomplete")


def _parsed(kind: Any, content: bytes | memoryview) -> Any:
    """A record of mcap from its content."""
    return kind.read(ReadDataStream(io.BytesIO(content)))

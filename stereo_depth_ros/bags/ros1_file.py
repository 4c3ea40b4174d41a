# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads ROS 1 bags of version 2.0 by their index, or, where it is missing or damaged, by a scan."""

from __future__ import annotations

import io
import struct
from collections import Counter
from collections.abc import Container, Iterator
from typing import NamedTuple

from stereo_depth_ros.bags.chunked_file import Channel, Chunk, ChunkedFile, StoredMessage
from stereo_depth_ros.bags.inflate import check_size, inflated, inflated_start
from stereo_depth_ros.bags.losses import cause_text
from stereo_depth_ros.core.errors import BagError

__all__ = ["Ros1File"]

_MAGIC = b"#ROSBAG V"
_MESSAGE, _BAG_HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7  # the op of a record
_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")  # seconds, nanoseconds
_PAIR = struct.Struct("<II")  # connection, number of messages
_LONGEST_HEADER = 2**20


class _Record(NamedTuple):
    """A record: the fields of its header, where its data begin, and how long they should be."""

    fields: dict[bytes, bytes]
    data: int
    length: int

    @property
    def op(self) -> int:
        """The kind of record."""
        return _number(self.fields.get(b"op", b""))

    @property
    def end(self) -> int:
        return self.data + self.length


class Ros1File(ChunkedFile):
    """A ROS 1 bag, compressed or not, indexed or not, complete or cut.

    Raises:
        BagError: not a ROS 1 bag of version 2.0, or an encrypted one.
    """

    def _open(self) -> None:
        self._size = self._file.seek(0, io.SEEK_END)
        first = self._content(0, 20).partition(b"\n")[0]
        if first != _MAGIC + b"2.0":
            raise BagError(
                f"is not a ROS 1 bag, it does not begin with {_MAGIC.decode()}2.0",
                subject=str(self.path),
                value=first.decode(errors="replace"),
                limit=f"{_MAGIC.decode()}2.0",
                remedy="check what the file is, or convert it with `rosbag fix` if it is of another version",
            )
        begin = len(first) + 1
        try:
            header = self._record_at(begin)
            encryptor = header.fields.get(b"encryptor", b"").decode()
        except Exception:  # damaged: the scan finds the next record
            return self._scan(begin)
        if encryptor:
            raise BagError(
                f"is encrypted with {encryptor}",
                subject=str(self.path),
                value=encryptor,
                remedy="decrypt it with `rosbag decrypt`",
            )
        try:
            self._read_index(header)
        except Exception:  # of hostile numbers too; a scan needs no index
            self.channels, self.chunks = {}, []
            self._scan(begin)
        return None

    def _read(self, chunk: Chunk, wanted: Container[int]) -> Iterator[StoredMessage]:
        for fields, data in self._chunk_records(self._record_at(chunk.offset)):
            if fields.get(b"op") == bytes((_MESSAGE,)):
                key = _number(fields[b"conn"], 4)
                if key in wanted:
                    yield StoredMessage(key, _time_ns(fields[b"time"]), bytes(data))

    def _read_index(self, header: _Record) -> None:
        """Fills channels and chunks from the records at the end of the bag.

        Raises:
            Exception: there is no index, or a record of it is damaged.
        """
        offset = _number(header.fields[b"index_pos"], 8)
        connections, chunks = _number(header.fields[b"conn_count"], 4), _number(header.fields[b"chunk_count"], 4)
        if not header.end <= offset <= self._size:
            raise ValueError("no index")
        while offset < self._size:
            record = self._record_at(offset)
            offset = record.end
            data = self._content(record.data, record.length)
            if record.op == _CONNECTION:
                self._add_connection(record.fields, data)
            elif record.op == _CHUNK_INFO:
                counts = dict(_PAIR.iter_unpack(data))
                times = _time_ns(record.fields[b"start_time"]), _time_ns(record.fields[b"end_time"])
                if counts:
                    self.chunks.append(Chunk(_number(record.fields[b"chunk_pos"], 8), *times, counts))
                chunks -= 1
            else:
                raise ValueError(f"a record of op {record.op}")
        known = all(chunk.counts.keys() <= self.channels.keys() for chunk in self.chunks)
        if chunks or connections != len(self.channels) or not known:
            raise ValueError("the index is incomplete")

    def _scan(self, offset: int) -> None:
        damaged: list[tuple[int, Counter[int], str]] = []
        last_is_damaged = False
        self.cut = True
        while offset < self._size:
            try:
                record = self._record_at(offset)
            except Exception:  # what comes next is not known
                break
            if record.op == _CHUNK:
                last_is_damaged = False
                try:
                    self._scan_chunk(offset, record)
                except Exception as error:  # of the libraries that decompress, and of the parser
                    damaged.append((offset, Counter(), cause_text(error)))
                    last_is_damaged = True
            elif record.op == _INDEX and last_is_damaged:
                damaged[-1][1][_number(record.fields.get(b"conn", b""))] += record.length // 12
            elif record.op == _CONNECTION and record.end <= self._size:
                self._add_connection(record.fields, self._content(record.data, record.length))
            elif record.op == _CHUNK_INFO:
                self.cut = record.end != self._size
            offset = record.end
        for place, counts, cause in damaged:
            self._counts.update(counts)
            self.losses.add_chunk((self.path, place), self.by_topic(counts), cause)

    def _scan_chunk(self, offset: int, record: _Record) -> None:
        counts: Counter[int] = Counter()
        start_ns, end_ns = 2**64, -1
        is_cut = record.end > self._size
        try:
            for fields, data in self._chunk_records(record):
                if fields.get(b"op") == bytes((_CONNECTION,)):
                    self._add_connection(fields, bytes(data))
                elif fields.get(b"op") == bytes((_MESSAGE,)):
                    log_time_ns = _time_ns(fields[b"time"])
                    counts[_number(fields[b"conn"], 4)] += 1
                    start_ns, end_ns = min(start_ns, log_time_ns), max(end_ns, log_time_ns)
        except Exception:  # the messages at the beginning of a chunk that is cut are all there is
            if not is_cut:
                raise
        if counts:
            self.chunks.append(Chunk(offset, start_ns, end_ns, counts, is_cut))

    def _add_connection(self, fields: dict[bytes, bytes], data: bytes) -> None:
        """A channel from a record; one that is damaged is left out, and its messages count as lost."""
        try:
            details = _fields(data)
            names = fields[b"topic"].decode(), details[b"type"].decode()
            key = _number(fields[b"conn"], 4)
        except (ValueError, KeyError, struct.error):
            return
        slash = "/" * names[0].startswith("/")
        topic = slash + "/".join(part for part in names[0].split("/") if part)  # ROS 1 allows double slashes
        self.channels[key] = Channel(topic, names[1], "ros1")

    def _chunk_records(self, record: _Record) -> Iterator[tuple[dict[bytes, bytes], memoryview]]:
        """Fields and data of the records in a chunk; those before its damage, then an Exception."""
        if record.op != _CHUNK:
            raise ValueError(f"a record of op {record.op} is where it should be")
        size = _number(record.fields[b"size"], 4)
        compression = record.fields[b"compression"].decode().replace("none", "")
        check_size(min(record.length, self._size - record.data))
        packed = self._content(record.data, record.length)
        self.budget.take(record.data, size)
        is_cut = record.end > self._size
        view = memoryview((inflated_start if is_cut else inflated)(packed, compression, size))
        yield from self.budget.counted(record.data, _split(view))

    def _record_at(self, offset: int) -> _Record:
        """The record at an offset, whose data the file may lack.

        Raises:
            Exception: there is none.
        """
        (length,) = _LENGTH.unpack(self._content(offset, 4))
        if length > _LONGEST_HEADER:
            raise ValueError(f"a header of {length} bytes")
        fields, start, data_length = _header(memoryview(self._content(offset, length + 8)), 0)
        return _Record(fields, offset + start, data_length)

    def _content(self, offset: int, length: int) -> bytes:
        """At most ``length`` bytes of the file; never allocates more than it has."""
        self._file.seek(offset)
        return self._file.read(min(length, max(self._size - offset, 0)))


def _split(view: memoryview) -> Iterator[tuple[dict[bytes, bytes], memoryview]]:
    """Fields and data of the records in a chunk."""
    offset = 0
    while offset < len(view):
        fields, start, length = _header(view, offset)
        offset = start + length
        if offset > len(view):
            raise ValueError("a record in it is incomplete")
        yield fields, view[start:offset]


def _header(view: memoryview, offset: int) -> tuple[dict[bytes, bytes], int, int]:
    """Fields of a record, where its data begin, and their length."""
    (length,) = _LENGTH.unpack_from(view, offset)
    end = offset + _LENGTH.size + length
    fields = _fields(bytes(view[offset + _LENGTH.size : end]))
    (data_length,) = _LENGTH.unpack_from(view, end)
    return fields, end + _LENGTH.size, data_length


def _fields(data: bytes) -> dict[bytes, bytes]:
    """Names and values, each pair with its length in front."""
    fields, offset = {}, 0
    while offset < len(data):
        (length,) = _LENGTH.unpack_from(data, offset)
        name, separator, value = data[offset + 4 : offset + 4 + length].partition(b"=")
        offset += 4 + length
        if not separator or offset > len(data):
            raise ValueError("a header is damaged")
        fields[name] = value
    return fields


def _number(value: bytes, size: int | None = None) -> int:
    """An unsigned number of ``size`` bytes."""
    if size is not None and len(value) != size:
        raise ValueError(f"a number of {len(value)} bytes, not {size}")
    return int.from_bytes(value, "little")


def _time_ns(value: bytes) -> int:
    seconds, nanoseconds = _TIME.unpack(value)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decompression with a maximum: what inflates further is refused while it inflates, and never held in memory."""

from __future__ import annotations

import bz2
import io
import shutil
from collections.abc import Callable, Hashable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import lz4.frame
import zstandard

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.quoted import quoted

__all__ = [
    "INFLATED_LIMIT",
    "ZSTD_MAGIC",
    "InflationBudget",
    "check_size",
    "inflate_file",
    "inflated",
    "inflated_start",
    "stated_size",
]

T = TypeVar("T")
INFLATED_LIMIT = 256 * 2**20  # bytes of a chunk or message; recorders write chunks of 1 MB, images have below 100 MB
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_FILE_LIMIT, _FILE_RATIO = 2**30, 200  # images compress to a half or a tenth
_TOTAL_LIMIT, _TOTAL_RATIO = 2**30, 1000  # all chunks; a lens cap gives a ratio of some hundreds, zeros of 30000
_RECORDS = 10**5
_PIECE = 2**20
_BLOCK = 2**17  # of zstd


class InflationBudget:
    """What the chunks and messages of one file may inflate to in total; each counts once, however often it is read.

    A chunk of a few bytes may state any number of empty records, so records are limited too.

    Args:
        file_bytes: size of the file.
    """

    def __init__(self, file_bytes: int) -> None:
        self._file_bytes = file_bytes
        self._bytes = max(_TOTAL_LIMIT, _TOTAL_RATIO * file_bytes)
        self._records = _RECORDS + file_bytes
        self._taken: set[Hashable] = set()
        self._counted: set[Hashable] = set()

    def take(self, place: Hashable, size: int) -> None:
        """Before a chunk or message is inflated.

        Raises:
            BagError: it is larger than ``INFLATED_LIMIT``, or all together are too large.
        """
        check_size(size)
        if place in self._taken:
            return
        if size > self._bytes:
            limit = max(_TOTAL_LIMIT, _TOTAL_RATIO * self._file_bytes)
            raise BagError(
                f"inflates to more than {limit} bytes in total, the maximum for a file of {self._file_bytes} bytes",
                value=limit - self._bytes + size,
                limit=limit,
                remedy="record it again without compression",
            )
        self._bytes -= size
        self._taken.add(place)

    def counted(self, place: Hashable, records: Iterator[T]) -> Iterator[T]:
        """The records of a chunk.

        Raises:
            BagError: all together are too many.
        """
        if place in self._counted:
            yield from records
            return
        for record in records:
            if not self._records:
                limit = _RECORDS + self._file_bytes
                raise BagError(
                    f"more than {limit} records in a file of {self._file_bytes} bytes",
                    value=limit + 1,
                    limit=limit,
                    remedy="record it again",
                )
            self._records -= 1
            yield record
        self._counted.add(place)


def check_size(size: int) -> None:
    """Refuses a size that a file states, before anything is read or allocated for it.

    Raises:
        BagError: above ``INFLATED_LIMIT``.
    """
    if size > INFLATED_LIMIT:
        raise BagError(
            f"{size} bytes in one chunk or message, the maximum is {INFLATED_LIMIT}",
            value=size,
            limit=INFLATED_LIMIT,
            remedy="record it again with smaller chunks",
        )


def inflated(data: bytes, compression: str, size: int | None = None) -> bytes | bytearray:
    """Decompressed data.

    Args:
        data: compressed.
        compression: "zstd", "lz4", "bz2", or "" for none.
        size: bytes that it must inflate to; None where that is not known.

    Raises:
        BagError: unknown compression, or more than ``INFLATED_LIMIT`` bytes.
        Exception: damaged data; the errors of the libraries have no common base class.
    """
    check_size(size or 0)
    if compression == "zstd" and size is not None and stated_size(data) == size:  # the usual case, in one step
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    limit = INFLATED_LIMIT if size is None else size
    result = bytearray()
    for piece in _pieces(data, compression, limit):
        result += piece
    if size is not None and len(result) != size:
        raise ValueError(f"{len(result)} bytes of {size}")
    return result


def stated_size(data: bytes) -> int | None:
    """What zstd data say that they inflate to; None where they do not say it.

    Raises:
        ZstdError: other data.
    """
    size = int(zstandard.get_frame_parameters(data).content_size)
    return None if size == zstandard.CONTENTSIZE_UNKNOWN else size


def inflated_start(data: bytes, compression: str, size: int) -> bytearray:
    """The beginning of what the beginning of compressed data inflates to, at most ``size`` bytes.

    Raises:
        BagError: unknown compression, or ``size`` above ``INFLATED_LIMIT``.
    """
    check_size(size)
    result = bytearray()
    try:
        for piece in _pieces(data, compression, size):
            result += piece
    except BagError:
        raise
    except Exception:  # where the data end; the errors of the libraries have no common base class
        pass
    return result


def inflate_file(path: Path, target: Path) -> BagError | None:
    """Decompresses a file of rosbag2, ``.mcap.zstd`` or ``.db3.zstd``, or its beginning where it is damaged.

    Returns:
        Why it ends before its end; None for a complete file. One that is cut is not recognized here.

    Raises:
        BagError: larger than 1 GiB and 200 times the compressed file, or more than the disk has room for.
    """
    limit = max(_FILE_LIMIT, _FILE_RATIO * path.stat().st_size)
    written = 0
    try:
        with path.open("rb") as source, target.open("wb") as file:
            reader = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
            while piece := reader.read(_BLOCK):  # what is in a piece before damage is lost
                written += len(piece)
                if written > limit or written > shutil.disk_usage(target.parent).free + file.tell():
                    break
                file.write(piece)
            else:
                return None
    except zstandard.ZstdError as error:
        return BagError(f"cannot be decompressed ({error})", subject=str(path), remedy="copy it again")
    raise BagError(
        f"inflates to more than {limit} bytes, the maximum for a file of {path.stat().st_size} bytes",
        subject=str(path),
        value=written,
        limit=limit,
        remedy="decompress it with `zstd -d` if it is yours",
    )


def _pieces(data: bytes, compression: str, limit: int) -> Iterator[bytes]:
    """What data inflate to, piece by piece."""
    total = 0
    for piece in _open(data, compression):
        total += len(piece)
        if total > limit:
            raise BagError(
                f"inflates to more than {limit} bytes",
                value=total,
                limit=limit,
                remedy="record it again",
            )
        yield piece


def _open(data: bytes, compression: str) -> Iterator[bytes]:
    if compression == "zstd":
        reader = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data), read_across_frames=True)
        return iter(lambda: reader.read(_PIECE), b"")
    if compression == "lz4":
        return _stepwise(lz4.frame.LZ4FrameDecompressor(), data)
    if compression == "bz2":
        return _stepwise(bz2.BZ2Decompressor(), data)
    if not compression:
        return iter((data,))
    raise BagError(
        f"compression {quoted(compression)} is not supported, supported are zstd, lz4, bz2 and none",
        value=compression,
        limit=("zstd", "lz4", "bz2", "none"),
        remedy="convert the bag to one of these",
    )


def _stepwise(decompressor: Any, data: bytes) -> Iterator[bytes]:
    step: Callable[[bytes, int], bytes] = decompressor.decompress
    size = max(_PIECE, 4 * len(data))  # few steps: each copies what it has not used of the data
    while not decompressor.eof:
        piece = step(data, size)
        data = b""
        if not piece and decompressor.needs_input:
            return
        yield piece

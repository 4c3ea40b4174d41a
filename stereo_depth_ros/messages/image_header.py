# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Headers of image files: size and sample bits of jpeg, png, tiff, webp, bmp, pnm and pfm without decoding them."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

__all__ = ["ImageHeader", "read_file_header", "read_header"]


_LONGEST_HEADER = 4096  # bytes, with comments


@dataclass(frozen=True)
class ImageHeader:
    """What the header of an image declares.

    Attributes:
        format: "jpeg", "png", "tiff", "webp", "bmp", "pnm" or "pfm".
        width, height: pixels, at least 1.
        bits: per sample.
    """

    format: str
    width: int
    height: int
    bits: int = 8


def read_header(data: bytes) -> ImageHeader | None:
    """The header of a compressed image; None for another format, or a header that is cut or contradictory."""
    return _read(data, _READERS)


def read_file_header(data: bytes) -> ImageHeader | None:
    """As :func:`read_header`, of the formats without compression too."""
    return _read(data, _READERS) or _read(data, dict.fromkeys(_PORTABLE, _portable))


def _read(data: bytes, readers: Mapping[bytes, Callable[[bytes], ImageHeader | None]]) -> ImageHeader | None:
    for start, read in readers.items():
        if data.startswith(start):
            try:
                header = read(data)
            except struct.error:  # cut
                return None
            return header if header is not None and min(header.width, header.height) > 0 else None
    return None


def _png(data: bytes) -> ImageHeader | None:
    width, height, bits = struct.unpack_from(">IIB", data, 16)
    return ImageHeader("png", width, height, bits) if data[12:16] == b"IHDR" else None


# Start of frame; C4, C8 and CC are other segments.
_JPEG_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def _jpeg(data: bytes) -> ImageHeader | None:
    at = 2
    while True:
        fill, marker = struct.unpack_from(">BB", data, at)
        if fill != 0xFF or marker == 0xDA:  # not a segment, or pixels before their frame
            return None
        if marker == 0xFF:
            at += 1
        elif marker in _JPEG_FRAMES:
            bits, height, width = struct.unpack_from(">BHH", data, at + 4)
            return ImageHeader("jpeg", width, height, bits)
        elif marker == 0x01 or 0xD0 <= marker <= 0xD7:  # without content
            at += 2
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]


_WIDTH, _HEIGHT, _BITS = 256, 257, 258


def _tiff(data: bytes) -> ImageHeader | None:
    tags = dict(_tiff_tags(data, "<" if data[:2] == b"II" else ">"))
    if not {_WIDTH, _HEIGHT} <= set(tags):
        return None
    return ImageHeader("tiff", tags[_WIDTH], tags[_HEIGHT], tags.get(_BITS, 1))


def _tiff_tags(data: bytes, order: str) -> Iterator[tuple[int, int]]:
    """Number and first value of the tags of 16 or 32 bit in the first directory."""
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, directory)
    for at in range(directory + 2, directory + 2 + 12 * count, 12):
        tag, kind, values = struct.unpack_from(f"{order}HHI", data, at)
        if code := {3: "H", 4: "I"}.get(kind):
            where = at + 8
            if values * struct.calcsize(f"{order}{code}") > 4:
                (where,) = struct.unpack_from(f"{order}I", data, where)
            yield tag, struct.unpack_from(f"{order}{code}", data, where)[0]


def _webp(data: bytes) -> ImageHeader | None:
    kind = data[8:16]
    if kind == b"WEBPVP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return ImageHeader("webp", width & 0x3FFF, height & 0x3FFF)
    if kind == b"WEBPVP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return ImageHeader("webp", 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF))
    if kind == b"WEBPVP8X":
        width, height = (int.from_bytes(struct.unpack_from("3s", data, at)[0], "little") for at in (24, 27))
        return ImageHeader("webp", 1 + width, 1 + height)
    return None


def _bmp(data: bytes) -> ImageHeader | None:
    (size,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if size == 12 else "<ii", data, 18)
    return ImageHeader("bmp", width, abs(height))  # negative: rows from top to bottom


_PORTABLE = (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6", b"Pf", b"PF")
_NUMBERS = re.compile(rb"P.((?:\s+|#[^\n]*\n)+)(\d{1,10})((?:\s+|#[^\n]*\n)+)(\d{1,10})\s")


def _portable(data: bytes) -> ImageHeader | None:
    """Of the Netpbm formats, and of pfm, which has a negative scale for little-endian floating-point numbers."""
    found = _NUMBERS.match(data[:_LONGEST_HEADER])
    if found is None:
        return None
    is_float = data[1:2] in b"fF"
    return ImageHeader("pfm" if is_float else "pnm", int(found[2]), int(found[4]), 32 if is_float else 8)


_READERS = {
    b"\xff\xd8\xff": _jpeg,
    b"\x89PNG\r\n\x1a\n": _png,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"RIFF": _webp,
    b"BM": _bmp,
}

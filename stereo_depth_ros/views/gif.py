# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Animated GIF files: a palette for all frames, and the compression of the format."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.views.color_order import as_bgr

__all__ = ["animated_gif"]

_BITS = 5  # of each channel that are told apart
_COLORS = 256
_LARGEST = 0xFFFF  # width and height in the format


def animated_gif(frames: Sequence[U8], frame_ms: int) -> bytes:
    """The bytes of a GIF that shows the frames in a loop (GIF89a, CompuServe 1990).

    The palette of 256 colors is that of all frames, by median cut (P. Heckbert, Color image quantization for frame
    buffer display, SIGGRAPH 1982).

    Args:
        frames: uint8 (H, W) or (H, W, 3) BGR, all of one size.
        frame_ms: how long each is shown, in steps of 10 ms.

    Raises:
        ImageError: no frames, different sizes, or a side above 65535 px.
    """
    if len({frame.shape[:2] for frame in frames}) != 1 or max(frames[0].shape[:2]) > _LARGEST:
        raise ImageError(
            f"{len(frames)} frames of {len({frame.shape[:2] for frame in frames})} sizes, an animation has one size of "
            f"at most {_LARGEST} px",
            value=[frame.shape[:2] for frame in frames],
            limit=_LARGEST,
            remedy="use images of one size",
        )
    height, width = frames[0].shape[:2]
    bins = [_bins(as_bgr(frame)) for frame in frames]
    palette, index = _palette(np.concatenate([each.ravel() for each in bins]))
    parts = [
        b"GIF89a" + struct.pack("<HHBBB", width, height, 0xF7, 0, 0) + palette.tobytes(),
        b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00",
    ]
    for each in bins:
        parts.append(b"\x21\xf9\x04\x04" + struct.pack("<H", max(1, round(frame_ms / 10))) + b"\x00\x00")
        parts.append(b"\x2c" + struct.pack("<HHHHB", 0, 0, width, height, 0) + b"\x08")
        packed = np.empty(2 * each.size + 16, np.uint8)
        parts.append(_blocks(packed[: _pack(index[each].ravel(), packed)].tobytes()))
    return b"".join((*parts, b"\x3b"))


def _bins(image: U8) -> npt.NDArray[np.int64]:
    """The number of each color, with 5 bits per channel."""
    blue, green, red = np.moveaxis(image >> (8 - _BITS), -1, 0).astype(np.int64)
    return np.asarray((red << 2 * _BITS) | (green << _BITS) | blue)


def _palette(bins: npt.NDArray[np.int64]) -> tuple[U8, U8]:
    """The palette, uint8 (256, 3) RGB, and the entry of each bin, uint8 (32768,)."""
    counts = np.bincount(bins, minlength=1 << 3 * _BITS)
    used = np.flatnonzero(counts)
    colors = np.stack([(used >> shift) & ((1 << _BITS) - 1) for shift in (2 * _BITS, _BITS, 0)], axis=1)
    boxes = [np.arange(len(used))]
    # of each box the pixels times the longest side, by which the next one is chosen
    scores = [_score(colors, counts[used], boxes[0])]
    while len(boxes) < _COLORS and max(scores) > 0:
        number = int(np.argmax(scores))
        halves = _halves(colors, counts[used], boxes[number])
        for at, half in zip((number, len(boxes)), halves, strict=True):
            boxes[at : at + 1] = [half]
            scores[at : at + 1] = [_score(colors, counts[used], half)]
    palette, index = np.zeros((_COLORS, 3), np.uint8), np.zeros(1 << 3 * _BITS, np.uint8)
    for number, box in enumerate(boxes):
        mean = np.average(colors[box], axis=0, weights=counts[used][box])
        palette[number] = np.rint(mean * 255 / ((1 << _BITS) - 1))
        index[used[box]] = number
    return palette, index


def _score(colors: npt.NDArray[np.int64], counts: npt.NDArray[np.int64], box: npt.NDArray[np.int64]) -> float:
    return float(counts[box].sum() * np.ptp(colors[box], axis=0).max() ** 2)


def _halves(
    colors: npt.NDArray[np.int64], counts: npt.NDArray[np.int64], box: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The box cut at the median of its longest side; no half is empty."""
    along = colors[box, np.ptp(colors[box], axis=0).argmax()]
    ordered = box[np.argsort(along, kind="stable")]
    total = np.cumsum(counts[ordered])
    cut = int(np.clip(np.searchsorted(total, total[-1] / 2), 1, len(box) - 1))
    return ordered[:cut], ordered[cut:]


def _blocks(data: bytes) -> bytes:
    """The data in blocks of at most 255 bytes, each after its length."""
    blocks = [data[at : at + 255] for at in range(0, len(data), 255)]
    return b"".join(bytes((len(block),)) + block for block in blocks) + b"\x00"


@compiled("int64(uint8[::1], uint8[::1])")
def _pack(indices: U8, packed: U8) -> int:
    """Compress (Welch 1984) with codes of 9 to 12 bits; the number of bytes written to ``packed``."""
    clear, end = 256, 257
    table = np.zeros((4096, 256), np.int16)  # code of a code and what follows it; 0 if there is none
    count, size, written = 258, 9, 0
    bits, held = np.uint64(clear), 9
    code = int(indices[0])
    for at in range(1, len(indices) + 2):
        following = 0
        if at < len(indices):
            following = int(table[code, indices[at]])
            if following:
                code = following
                continue
        elif at > len(indices):
            code = end
        bits |= np.uint64(code) << np.uint64(held)
        held += size
        while held >= 8:
            packed[written] = np.uint8(bits & np.uint64(255))
            bits >>= np.uint64(8)
            held -= 8
            written += 1
        if at < len(indices):
            if count < 4096:
                table[code, indices[at]] = count
                size = size + 1 if count == 1 << size else size
                count += 1
            else:
                bits |= np.uint64(clear) << np.uint64(held)
                held += size
                table[:] = 0
                count, size = 258, 9
            code = int(indices[at])
        elif at == len(indices) and count < 4096 and count == 1 << size:
            size += 1  # the decoder adds an entry before it reads the end
    if held > 0:
        packed[written] = np.uint8(bits & np.uint64(255))
        written += 1
    return written

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Census transform, and its Hamming distances as matching costs."""

from __future__ import annotations

from typing import Any, TypeAlias

import numba
import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import intrinsic

from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import U8, U16

__all__ = ["CENSUS_BITS", "CENSUS_WINDOW", "U64", "census_rows", "cost_rows"]

U64: TypeAlias = npt.NDArray[np.uint64]

RADIUS_X, RADIUS_Y = 4, 3
CENSUS_WINDOW = (2 * RADIUS_X + 1, 2 * RADIUS_Y + 1)  # width, height
CENSUS_BITS = CENSUS_WINDOW[0] * CENSUS_WINDOW[1] - 1
NEUTRAL_COST = np.uint8(CENSUS_BITS // 2)  # average cost of unrelated pixels

_ONE, _EIGHT = np.uint8(1), np.uint64(8)
_ONE_16 = np.uint16(1)
_SHARE_BITS, _HALF = np.uint32(16), np.uint32(1 << 15)  # of 1 / number of pairs, rounded


@intrinsic  # type: ignore[untyped-decorator]
def _popcount(_: Any, value: Any) -> Any:
    """Number of set bits; LLVM vectorizes it."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@compiled(allocates=False)
def _add_bit(neighbors: U8, centers: U8, codes: U8) -> None:
    for x in range(codes.size):
        codes[x] = np.uint8(np.uint8(codes[x] << _ONE) | np.uint8(neighbors[x] < centers[x]))


@compiled(allocates=False)
def _add_byte(part: U8, codes: U64) -> None:
    for x in range(codes.size):
        codes[x] = (codes[x] << _EIGHT) | np.uint64(part[x])


@compiled(numba.void(numba.int64, numba.int64, READ_ONLY_U8, numba.uint64[:, ::1]))
def census_rows(first: int, last: int, image: U8, codes: U64) -> None:
    """Census transform with a window of 9 x 7: a bit is set if the neighbor is darker than the center.

    Zabih and Woodfill, "Non-parametric local transforms for computing visual correspondence", ECCV 1994. The image
    is extended by its border pixels.

    Args:
        first, last: rows to write.
        image: uint8 (H, W).
        codes: uint64 (H, W).
    """
    height, width = image.shape
    window = np.empty((2 * RADIUS_Y + 1, width + 2 * RADIUS_X), np.uint8)
    part = np.zeros(width, np.uint8)
    for y in range(first, last):
        for j in range(2 * RADIUS_Y + 1):
            row = image[min(max(y + j - RADIUS_Y, 0), height - 1)]
            window[j, :RADIUS_X] = row[0]
            window[j, RADIUS_X:-RADIUS_X] = row
            window[j, -RADIUS_X:] = row[width - 1]
        codes[y] = 0
        centers = window[RADIUS_Y, RADIUS_X : RADIUS_X + width]
        bits = 0
        for j in range(2 * RADIUS_Y + 1):
            for i in range(2 * RADIUS_X + 1):
                if i != RADIUS_X or j != RADIUS_Y:
                    _add_bit(window[j, i : i + width], centers, part)
                    bits += 1
                    if bits % 8 == CENSUS_BITS % 8:  # accumulated in bytes: eight times as many pixels per vector
                        _add_byte(part, codes[y])
                        part[:] = 0


@compiled(allocates=False)
def _mean(a: np.uint8, b: np.uint8) -> np.uint8:
    """(a + b) / 2, rounded up: one vector instruction for bytes."""
    return np.uint8(np.uint16(np.uint16(a) + np.uint16(b) + _ONE_16) >> _ONE_16)


@compiled(allocates=False)
def _quarter_half_quarter(before: U8, here: U8, after: U8, out: U8) -> None:
    for i in range(out.size):
        out[i] = _mean(_mean(before[i], after[i]), here[i])


@compiled(allocates=False)
def _hamming(code: np.uint64, others: U64, out: U8) -> None:
    for k in range(out.size):
        out[k] = np.uint8(_popcount(code ^ others[k]))


@compiled(allocates=False)
def _add_hamming(code: np.uint64, others: U64, sums: U16) -> None:
    for k in range(sums.size):
        sums[k] = np.uint16(sums[k] + np.uint16(_popcount(code ^ others[k])))


@compiled(allocates=False)
def _mean_hamming(census: U64, y: int, x: int, first: int, sums: U16, out: U8) -> None:
    """Means over the pairs of the distances of left pixel (x, y) to the right pixels from column ``first`` on."""
    pairs = len(census)
    sums[:] = 0
    for n in range(pairs):
        _add_hamming(census[n, 0, y, x], census[n, 1, y, first : first + out.size], sums)
    share = np.uint32(((1 << 16) + pairs // 2) // pairs)
    for k in range(out.size):
        out[k] = np.uint8(np.uint32(np.uint32(sums[k]) * share + _HALF) >> _SHARE_BITS)


@compiled(allocates=False)
def _hamming_row(census: U64, y: int, max_disparity: int, raw: U8, sums: U16) -> None:
    """Distances of one row, from ``raw[1]`` on; the first and last pixel are repeated for the smoothing."""
    width, count = census.shape[3], raw.shape[1]
    for x in range(width):
        at = x - max_disparity  # right column of index 0
        begin, end = min(max(-at, 0), count), max(min(width - at, count), 0)
        here = raw[x + 1]
        if begin < end:
            if len(census) == 1:
                _hamming(census[0, 0, y, x], census[0, 1, y, at + begin : at + end], here[begin:end])
            else:
                _mean_hamming(census, y, x, at + begin, sums[begin:end], here[begin:end])
            here[:begin] = min(here[begin], NEUTRAL_COST)
            here[end:] = min(here[end - 1], NEUTRAL_COST)
        else:
            here[:] = NEUTRAL_COST
    for k in range(count):
        raw[0, k] = raw[1, k]
        raw[width + 1, k] = raw[width, k]


@compiled(allocates=False)
def cost_rows(census: U64, first: int, last: int, max_disparity: int, raw: U8, sums: U16, smooth: U8, cost: U8) -> None:
    """Matching costs of a band of rows: Hamming distances, smoothed by (1 2 1) / 4 along x and along y.

    Of several pairs of one scene the distance is the mean over the pairs, rounded to whole bits.

    Index k of a cost counts down from the largest disparity, so that it increases along the right image. Outside the
    right image the distance of the border pixel is repeated, at most ``NEUTRAL_COST``: a constant would favor the
    disparities inside, and paths would propagate that bias over images without texture.

    Args:
        census: of the left and the right image of each pair, uint64 (pairs, 2, H, W).
        first, last: rows whose costs are written, from ``cost[0]`` on.
        max_disparity: largest disparity, px.
        raw: scratch, uint8 (W + 2, K).
        sums: scratch, uint16 (K,).
        smooth: scratch, uint8 (3, W, K), the latest rows smoothed along x.
        cost: uint8 (rows, W, K), at most 62.
    """
    height, width = census.shape[2:]
    done = -1
    for y in range(first, last):
        for near in range(max(y - 1, 0), min(y + 2, height)):
            if near > done:
                _hamming_row(census, near, max_disparity, raw, sums)
                for x in range(width):
                    _quarter_half_quarter(raw[x], raw[x + 1], raw[x + 2], smooth[near % 3, x])
                done = near
        above, below = max(y - 1, 0) % 3, min(y + 1, height - 1) % 3
        for x in range(width):
            _quarter_half_quarter(smooth[above, x], smooth[y % 3, x], smooth[below, x], cost[y - first, x])

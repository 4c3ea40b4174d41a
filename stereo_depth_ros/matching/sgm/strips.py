# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching of strips of rows: costs, paths, sums and winners, in cache-sized buffers."""

from __future__ import annotations

import math
from mmap import PAGESIZE
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import float32, float64, int16, int64, uint8, uint16, uint32, uint64
from numpy.typing import DTypeLike

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import F32, U8, Reason
from stereo_depth_ros.matching.costs.census import U64, cost_rows
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.selection.summed_costs import (
    NO_KEY,
    U16,
    U32,
    least_key,
    left_right_row,
    lower_keys,
    make_keys,
    second_key,
    subpixel,
)
from stereo_depth_ros.matching.sgm.path_costs import LARGEST_PATH_COST, path_step, start_path, step_row

__all__ = ["SPECKLE_STEPS_PER_PX", "STEPS_PER_PX", "Output", "Scratch", "Search", "match_bands"]

STEPS_PER_PX = 64
SPECKLE_STEPS_PER_PX = 8  # 4096 disparities fit in 16 bits
_BORDER, _UNIQUENESS = np.uint8(Reason.BORDER), np.uint8(Reason.UNIQUENESS)
_INDEX, _TOTAL = np.uint32(0xFFFF), np.uint32(16)
_APART = 2  # per-pixel buffers of two bands must not share a cache line (false sharing)


class Search(NamedTuple):
    """Search range and checks.

    ``uniqueness`` is the minimum margin over the second best, ``tolerance`` that of the left-right check in px; P2 is
    indexed by the gray difference of neighbors; ramp is 0, 1, 2 ...; vertical paths start ``approach_rows`` before the
    strip.
    """

    max_disparity: int
    uniqueness: float
    tolerance: int
    P1: np.uint8
    P2: U8
    ramp: U32
    approach_rows: int


class Scratch(NamedTuple):
    """Buffers of a strip; in the matcher with one more leading dimension, the band.

    There are 1 or 3 directions from the rows above, and as many from below; K + 2: see path_costs.py.
    """

    raw: U8  # (W + 2, K) see cost_rows
    sums: U16  # (K,) see cost_rows
    smooth: U8  # (3, W, K)
    cost: U8  # (rows, W, K) matching costs
    down: U8  # (directions, rows, W, K + 2) path costs from above
    up: U8  # (directions, 2, W, K + 2) path costs from below, of two alternating rows
    along: U8  # (2, K + 2) path costs from the left or right, of two alternating pixels
    least_down: U8  # (directions, 2, W) minimum path cost of each pixel, of two alternating rows
    least_up: U8
    totals: U16  # (W, K) sums of path costs
    keys: U32  # (K,)
    right_keys: U32  # (W + K,)
    best: U16  # (W,)

    @classmethod
    def allocate(cls, bands: int, rows: int, width: int, config: MatchingConfig) -> Scratch:
        """Buffers of all bands, for strips of up to ``rows`` rows, warm-up included, and ``width`` columns."""
        count = config.num_disparities
        directions = 1 if config.sgm_paths == 4 else 3
        never = LARGEST_PATH_COST - config.sgm_P1
        return cls(
            raw=_on_pages((bands, width + 2, count), np.uint8),
            sums=_on_pages((_APART * bands, count), np.uint16),
            smooth=_on_pages((bands, 3, width, count), np.uint8),
            cost=_on_pages((bands, rows, width, count), np.uint8),
            down=_on_pages((bands, directions, rows, width, count + 2), np.uint8, never),
            up=_on_pages((bands, directions, 2, width, count + 2), np.uint8, never),
            along=_on_pages((_APART * bands, 2, count + 2), np.uint8, never),
            least_down=_on_pages((bands, directions, 2, width), np.uint8),
            least_up=_on_pages((bands, directions, 2, width), np.uint8),
            totals=_on_pages((bands, width, count), np.uint16),
            keys=_on_pages((_APART * bands, count), np.uint32),
            right_keys=_on_pages((bands, width + count), np.uint32),
            best=_on_pages((bands, width), np.uint16),
        )


def _on_pages(shape: tuple[int, ...], dtype: DTypeLike, fill: int = 0) -> Any:
    """A page-aligned array, so that vectors of its rows cover few cache lines."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.empty(size + PAGESIZE, np.uint8)
    begin = -memory.ctypes.data % PAGESIZE
    array = memory[begin : begin + size].view(dtype).reshape(shape)
    array[...] = fill
    return array


class Output(NamedTuple):
    """Disparities (px, unfiltered), the same in coarse steps for the speckle filter, reasons and margin, (H, W)."""

    disparity_px: F32
    coarse: I16
    reasons: U8
    margin: F32


@compiled(allocates=False)
def _edge(image: U8, x: int, x_before: int) -> int:
    return int(abs(np.int64(image[x]) - np.int64(image[x_before])))


@compiled(allocates=False)
def _sum_row(image: U8, i: int, search: Search, scratch: Scratch) -> None:
    """Totals of row ``i`` of the strip over all paths except the one from the right."""
    least = np.uint8(0)
    for x in range(image.size):
        path = scratch.along[x % 2]
        if x == 0:
            least = start_path(scratch.cost[i, x], path)
        else:
            P2 = search.P2[_edge(image, x, x - 1)]
            least = path_step(scratch.along[1 - x % 2], least, scratch.cost[i, x], search.P1, P2, path)
        total = scratch.totals[x]
        above, below = scratch.down[0, i, x], scratch.up[0, i % 2, x]
        for k in range(total.size):
            vertical = np.uint16(np.uint16(above[k + 1]) + np.uint16(below[k + 1]))
            total[k] = np.uint16(vertical + np.uint16(path[k + 1]))
        for n in range(1, len(scratch.down)):
            above, below = scratch.down[n, i, x], scratch.up[n, i % 2, x]
            for k in range(total.size):
                diagonal = np.uint16(np.uint16(above[k + 1]) + np.uint16(below[k + 1]))
                total[k] = np.uint16(total[k] + diagonal)


@compiled(allocates=False)
def _limit_keys(keys: U32, at: int, width: int) -> bool:
    """Remove keys of right pixels outside the image; index 0 is right column ``at``. True if any remains."""
    begin, end = min(max(-at, 0), keys.size), max(min(width - at, keys.size), 0)
    if begin > 0 or end < keys.size:
        keys[:begin] = NO_KEY
        keys[end:] = NO_KEY
    return begin < end


@compiled(allocates=False)
def _take_winner(keys: U32, x: int, y: int, search: Search, best: U16, output: Output) -> None:
    winner = least_key(keys)
    at = int(winner & _INDEX)
    first = np.float32(winner >> _TOTAL)
    rival = second_key(keys, search.ramp, at)
    second = first if rival == NO_KEY else np.float32(rival >> _TOTAL)  # without a second candidate the margin is 0
    margin = (second - first) / max(second, np.float32(1))
    index = np.rint((at + subpixel(keys, at)) * STEPS_PER_PX) / STEPS_PER_PX
    best[x] = at
    output.disparity_px[y, x] = search.max_disparity - index
    output.coarse[y, x] = np.int16((keys.size - 1 - index) * SPECKLE_STEPS_PER_PX)
    output.margin[y, x] = margin
    output.reasons[y, x] = _UNIQUENESS if margin < search.uniqueness else 0


@compiled(allocates=False)
def _winners_row(image: U8, i: int, y: int, search: Search, scratch: Scratch, output: Output) -> None:
    """Add the path from the right to the totals of strip row ``i`` and select the winners of image row ``y``."""
    width = image.size
    scratch.right_keys[:] = NO_KEY
    least = np.uint8(0)
    for j in range(width):
        x = width - 1 - j
        path = scratch.along[x % 2]
        if j == 0:
            least = start_path(scratch.cost[i, x], path)
        else:
            P2 = search.P2[_edge(image, x, x + 1)]
            least = path_step(scratch.along[1 - x % 2], least, scratch.cost[i, x], search.P1, P2, path)
        make_keys(scratch.totals[x], path, search.ramp, scratch.keys)
        if _limit_keys(scratch.keys, x - search.max_disparity, width):
            lower_keys(scratch.keys, scratch.right_keys[x : x + scratch.keys.size])
            _take_winner(scratch.keys, x, y, search, scratch.best, output)
        else:
            output.reasons[y, x] = _BORDER
    left_right_row(scratch.best, scratch.right_keys, search.tolerance, output.reasons[y])


@compiled(allocates=False)
def _shift(n: int, directions: int) -> int:
    """Columns by which paths of direction n shift per row: 0, and for eight paths also the diagonals."""
    return (n + 1) % 3 - 1 if directions == 3 else 0


@compiled(allocates=False)
def _match_strip(a: int, b: int, image: U8, census: U64, search: Search, scratch: Scratch, output: Output) -> None:
    """Disparities of rows a to b, last exclusive."""
    s = scratch
    height, width = image.shape
    top, bottom = max(a - search.approach_rows, 0), min(b + search.approach_rows, height)
    directions = len(s.down)
    cost_rows(census, top, bottom, search.max_disparity, s.raw, s.sums, s.smooth, s.cost)
    for y in range(top, b):
        i, before = y - top, max(y - 1 - top, 0)
        for n in range(directions):
            shift = _shift(n, directions) if y > top else width  # all paths start in the first row
            old, new = s.least_down[n, 1 - i % 2], s.least_down[n, i % 2]
            rows = image[y], image[top + before]
            step_row(*rows, shift, s.cost[i], search.P1, search.P2, s.down[n, before], old, s.down[n, i], new)
    for j in range(bottom - a):
        y = bottom - 1 - j
        i = y - top
        for n in range(directions):
            shift = _shift(n, directions) if j > 0 else width
            old, new = s.least_up[n, 1 - i % 2], s.least_up[n, i % 2]
            rows = image[y], image[min(y + 1, height - 1)]
            step_row(*rows, shift, s.cost[i], search.P1, search.P2, s.up[n, 1 - i % 2], old, s.up[n, i % 2], new)
        if y < b:
            _sum_row(image[y], i, search, s)
            _winners_row(image[y], i, y, search, s, output)


_SEARCH = numba.types.NamedTuple([int64, float64, int64, uint8, uint8[::1], uint32[::1], int64], Search)
_SCRATCH = numba.types.NamedTuple(
    [
        *(uint8[:, :, ::1], uint16[:, ::1], uint8[:, :, :, ::1], uint8[:, :, :, ::1]),
        *(uint8[:, :, :, :, ::1], uint8[:, :, :, :, ::1]),
        *(uint8[:, :, ::1], uint8[:, :, :, ::1], uint8[:, :, :, ::1]),
        *(uint16[:, :, ::1], uint32[:, ::1], uint32[:, ::1], uint16[:, ::1]),
    ],
    Scratch,
)
_OUTPUT = numba.types.NamedTuple([float32[:, ::1], int16[:, ::1], uint8[:, ::1], float32[:, ::1]], Output)


@compiled(
    numba.void(int64, int64, int64, int64, READ_ONLY_U8, uint64[:, :, :, ::1], _SEARCH, _SCRATCH, _OUTPUT),
    allocates=False,
)
def match_bands(
    first: int,
    last: int,
    bands: int,
    strips: int,
    image: U8,
    census: U64,
    search: Search,
    scratch: Scratch,
    output: Output,
) -> None:
    """Match the strips of each band, with the scratch buffers of the band."""
    height = len(image)
    for band in range(first, last):
        own = Scratch(
            scratch.raw[band],
            scratch.sums[_APART * band],
            scratch.smooth[band],
            scratch.cost[band],
            scratch.down[band],
            scratch.up[band],
            scratch.along[_APART * band],
            scratch.least_down[band],
            scratch.least_up[band],
            scratch.totals[band],
            scratch.keys[_APART * band],
            scratch.right_keys[band],
            scratch.best[band],
        )
        for strip in range(band * strips // bands, (band + 1) * strips // bands):
            a, b = height * strip // strips, height * (strip + 1) // strips
            _match_strip(a, b, image, census, search, own, output)

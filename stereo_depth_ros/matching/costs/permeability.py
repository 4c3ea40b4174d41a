# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Edge-aware smoothing of costs by recursive filters: a cost spreads as far as neighbors have similar gray levels.

Information permeability (Cigla and Alatan, "Information permeability for stereo matching", Signal Processing: Image
Communication 2013, equations 2 to 5): from the left, sum(x) = cost(x) + a(x) sum(x - 1), where a falls with the gray
difference of both pixels, likewise from the right; both together are a weighted mean. The same follows along y, for a
group of rows at once: all rows above have a share, from below those of the group and the next one, so that few rows
are in memory.

All values are whole numbers; a product with a 16-bit share is cut off to its upper 16 bits. Words are in the order of
even_words and odd_words: those of a vector of bytes are two vectors.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import F32, U8, U16
from stereo_depth_ros.core.vectors import (
    BYTES,
    WORDS,
    add,
    even_words,
    join_words,
    load,
    multiply,
    multiply_high,
    odd_words,
    repeat,
    store,
    union,
)
from stereo_depth_ros.matching.costs.windows import TILE_ROWS, Windows, fill_missing, run_of, window_at

__all__ = ["GROUP", "permeabilities", "permeability_rows", "smooth_along", "smooth_down"]

GROUP = 4  # rows that are smoothed along y at once
LARGEST, GRAY_LEVELS = 0.9, 4.0  # permeability between equal pixels, and the difference at which it falls to 1 / e
ALONG_GAIN = 4  # of costs after the smoothing along x, for precision in bytes
DOWN_GAIN = 0.5  # of those after the one along y: half bits
_FINE = np.uint16(16)  # costs in sums: with LARGEST they stay below 16 bits
_WHOLE = 65536.0
_TYPICAL = np.uint8(12 * ALONG_GAIN)  # what disparities cost that are not searched
_AT_ONCE = 8  # rows whose weights are summed in a vector


def permeabilities() -> U16:
    """The share of a sum that passes between two pixels, by their gray difference; uint16 (256,), 65536 is all."""
    return np.array([round(_WHOLE * LARGEST * math.exp(-step / GRAY_LEVELS)) for step in range(256)], np.uint16)


@compiled(numba.void(numba.int64, numba.int64, READ_ONLY_U8, numba.uint16[::1], *(3 * (numba.uint16[:, ::1],))))
def permeability_rows(first: int, last: int, image: U8, table: U16, along: U16, scales: U16, down: U16) -> None:
    """Permeabilities of an image, and the scales of the sums along its rows.

    Args:
        first, last: rows to write.
        image: uint8 (H, W).
        table: see :func:`permeabilities`.
        along: uint16 (H, W), permeability to the pixel to the left; 0 in the first column.
        down: uint16 (H + 2 GROUP, W), to the pixel above; 0 in the first row, and below the image as it was.
        scales: uint16 (H, W), of the sum from the left and from the right.
    """
    width = image.shape[1]
    shares = np.zeros((width + 1, _AT_ONCE), np.float32)
    weights = np.zeros((width, _AT_ONCE), np.float32)
    weight = np.zeros(_AT_ONCE, np.float32)
    whole, one = np.float32(1 / _WHOLE), np.float32(1)
    scale = np.float32(_WHOLE * ALONG_GAIN / _FINE)
    for begin in range(first, last, _AT_ONCE):
        end = min(begin + _AT_ONCE, last)
        for y in range(begin, end):
            along[y, 0] = 0
            for x in range(1, width):
                along[y, x] = table[abs(np.int64(image[y, x]) - np.int64(image[y, x - 1]))]
                shares[x, y - begin] = np.float32(along[y, x]) * whole
            for x in range(width):
                down[y, x] = table[abs(np.int64(image[y, x]) - np.int64(image[y - 1, x]))] if y > 0 else 0
        weight[:] = 0
        for x in range(width):
            for i in range(_AT_ONCE):
                weight[i] = one + weight[i] * shares[x, i]
                weights[x, i] = weight[i]
        weight[:] = 0
        for j in range(width):
            x = width - 1 - j
            for i in range(_AT_ONCE):
                beyond = weight[i] * shares[x + 1, i]
                weights[x, i] = np.divide(scale, weights[x, i] + beyond)  # without a test for 0
                weight[i] = one + beyond
        for y in range(begin, end):
            for x in range(width):
                scales[y, x] = np.uint16(np.rint(weights[x, y - begin]))


@compiled(allocates=False, inlined=False)
def _move(before: U16, first_before: int, size_before: int, first: int, size: int, moved: U16) -> None:
    """Sums of a window as those of another one; the mean of all stands for those that it does not have.

    Args:
        before: uint16 (K,), the words of the vectors of the window from its first index on.
        moved: uint16 (K,), written, the same of the other window.
    """
    total = np.int64(0)
    for k in range(first_before, first_before + size_before):
        total += np.int64(before[k])
    fill = np.uint16(total // size_before)
    for k in range(size):
        j = first + k - first_before
        inside = 0 <= j < size_before
        value = before[first_before + _word(j)] if inside else fill
        moved[first + _word(k)] = value


@compiled(allocates=False)
def _word(k: int) -> int:
    """Where the word of byte k of a row of vectors is."""
    return k // BYTES * BYTES + (k % BYTES >> 1) + (k & 1) * WORDS


@compiled(allocates=False, inlined=False)
def smooth_along(
    first: int,
    last: int,
    windows: Windows,
    along: U16,
    scales: U16,
    raw: U8,
    forward: U16,
    backward: U16,
    moved: U16,
    smooth: U8,
) -> None:
    """Smooth the costs of rows first to last, last exclusive, along x.

    Args:
        windows: what is searched; both rows are in one tile row.
        along, scales: see :func:`permeability_rows`.
        raw: uint8 (rows, W + 2, K), costs of row first + i in ``raw[i]``, from pixel 1 on; at most 32.
        forward, backward, moved: scratch, uint16 (rows, W + 1, K), (rows, K) and (K,).
        smooth: uint8 (2 GROUP, W, K), row y is written to y % (2 GROUP), ``ALONG_GAIN`` times the cost.
    """
    width, size, start = along.shape[1], smooth.shape[2], first % (2 * GROUP)
    fine = repeat(_FINE)
    forward[:, width] = 0
    backward[:] = 0
    # Elements are counted over all dimensions: a view for each pixel would take as long as its sums.
    tile = first // TILE_ROWS
    for run in range(windows.run_count[tile]):
        begin, end, low, some = run_of(windows, tile, run)
        if run > 0:
            for i in range(last - first):  # what the window has of the sums before, behind the last pixel
                former = window_at(windows, tile, begin - 1)
                _move(forward[i, begin - 1], former[0], former[1], low, some, forward[i, width])
        for x in range(begin, end):
            for y in range(first, last):
                i = y - first
                share = repeat(along[y, x])
                at, cost_at = (i * (width + 1) + x) * size + low, (i * (width + 2) + x + 1) * size + low
                before_at = at + ((width - x) * size if x == begin else -size)
                for k in range(0, some, BYTES):
                    cost = load(raw, cost_at + k)
                    even, odd = multiply(even_words(cost), fine), multiply(odd_words(cost), fine)
                    store(forward, at + k, add(even, multiply_high(load(forward, before_at + k), share)))
                    store(forward, at + k + WORDS, add(odd, multiply_high(load(forward, before_at + k + WORDS), share)))
    for reverse in range(windows.run_count[tile]):
        run = windows.run_count[tile] - 1 - reverse
        begin, end, low, some = run_of(windows, tile, run)
        if reverse > 0:
            for i in range(last - first):
                former = window_at(windows, tile, end)
                _move(backward[i], former[0], former[1], low, some, moved)
                for k in range(low, low + some):
                    backward[i, k] = moved[k]
        for j in range(end - begin):
            x = end - 1 - j
            for y in range(first, last):
                i = y - first
                slot = (start + i) & (2 * GROUP - 1)
                share, scale = repeat(along[y, x + 1] if x + 1 < width else np.uint16(0)), repeat(scales[y, x])
                at, cost_at = (i * (width + 1) + x) * size + low, (i * (width + 2) + x + 1) * size + low
                beyond_at, out_at = i * size + low, (slot * width + x) * size + low
                for k in range(0, some, BYTES):
                    cost = load(raw, cost_at + k)
                    even = multiply_high(load(backward, beyond_at + k), share)
                    odd = multiply_high(load(backward, beyond_at + k + WORDS), share)
                    all_even, all_odd = add(load(forward, at + k), even), add(load(forward, at + k + WORDS), odd)
                    store(smooth, out_at + k, join_words(multiply_high(all_even, scale), multiply_high(all_odd, scale)))
                    store(backward, beyond_at + k, add(multiply(even_words(cost), fine), even))
                    store(backward, beyond_at + k + WORDS, add(multiply(odd_words(cost), fine), odd))


@compiled(allocates=False, inlined=False)
def smooth_down(
    first: int,
    starts: bool,
    windows: Windows,
    down: U16,
    unused: U8,
    weights: F32,
    scales: U16,
    above: U16,
    below: U16,
    moved: U16,
    smooth: U8,
    cost: U8,
) -> None:
    """Smooth the costs of rows ``first`` to ``first`` + GROUP along y; called for one group after the other.

    All rows above have a share in a row, and from below those of the group and the next one.

    Args:
        starts: whether this is the first group: above is nothing.
        windows: what is searched.
        down: see :func:`permeability_rows`.
        unused: uint8 (K,), 255 where an element only fills a vector, otherwise 0.
        weights: float32 (2 + GROUP, W), scratch that keeps the sums of weights above in row 0.
        scales: uint16 (GROUP, W), scratch.
        above: uint16 (W, K), the sums down to the last row.
        below, moved: uint16 (GROUP, BYTES) and (K,), scratch.
        smooth: uint8 (2 GROUP, W, K), row y at y % (2 GROUP), see :func:`smooth_along`; rows below the image have no
            share.
        cost: uint8 (GROUP, W, K), written: twice the costs, at most 64.
    """
    width, size, middle = down.shape[1], unused.size, first % (2 * GROUP)
    if starts:
        weights[0] = 0
        above[:] = 0
    _down_scales(first, down, weights, scales)
    tile = first // TILE_ROWS
    if first % TILE_ROWS == 0 and not starts:
        _move_above(windows, tile, above, moved)
    if (first + GROUP) % TILE_ROWS == 0 and tile + 1 < len(windows.first):
        _fill_next(windows, tile, middle, smooth)
    fine = repeat(_FINE)
    nothing = repeat(np.uint16(0))
    for run in range(windows.run_count[tile]):
        begin, end, low, some = run_of(windows, tile, run)
        for x in range(begin, end):
            for k in range(low, low + some, BYTES):
                even, odd = nothing, nothing
                for i in range(2 * GROUP - 1, -1, -1):
                    if i < GROUP:
                        store(below, i * BYTES, even)
                        store(below, i * BYTES + WORDS, odd)
                    share = repeat(down[first + i, x])
                    here = load(smooth, (((middle + i) & (2 * GROUP - 1)) * width + x) * size + k)
                    even = multiply_high(add(multiply(even_words(here), fine), even), share)
                    odd = multiply_high(add(multiply(odd_words(here), fine), odd), share)
                above_at = x * size + k
                even, odd = load(above, above_at), load(above, above_at + WORDS)
                for i in range(GROUP):
                    share, scale = repeat(down[first + i, x]), repeat(scales[i, x])
                    here = load(smooth, ((middle + i) * width + x) * size + k)
                    even = add(multiply(even_words(here), fine), multiply_high(even, share))
                    odd = add(multiply(odd_words(here), fine), multiply_high(odd, share))
                    all_even = multiply_high(add(even, load(below, i * BYTES)), scale)
                    all_odd = multiply_high(add(odd, load(below, i * BYTES + WORDS)), scale)
                    store(cost, (i * width + x) * size + k, union(join_words(all_even, all_odd), load(unused, k)))
                store(above, above_at, even)
                store(above, above_at + WORDS, odd)


@compiled(allocates=False, inlined=False)
def _move_above(windows: Windows, tile: int, above: U16, moved: U16) -> None:
    """The sums above a tile row, as those of its windows."""
    for x in range(len(above)):
        low, some = window_at(windows, tile, x)
        low_before, some_before = window_at(windows, tile - 1, x)
        if low != low_before or some != some_before:
            _move(above[x], low_before, some_before, low, some, moved)
            for k in range(low, low + some):
                above[x, k] = moved[k]


@compiled(allocates=False, inlined=False)
def _fill_next(windows: Windows, tile: int, middle: int, smooth: U8) -> None:
    """Costs of the group of rows below, which the windows of its tile row do not have."""
    for x in range(smooth.shape[1]):
        low, some = window_at(windows, tile, x)
        low_next, some_next = window_at(windows, tile + 1, x)
        if low != low_next or some != some_next:
            for i in range(GROUP):
                fill_missing(
                    smooth[(middle + GROUP + i) & (2 * GROUP - 1), x], low_next, some_next, low, some, _TYPICAL
                )


@compiled(allocates=False, inlined=False)
def _down_scales(first: int, down: U16, weights: F32, scales: U16) -> None:
    """The scales of the sums of a group of rows: the same recursions for costs of 1."""
    share, scale, one = np.float32(1 / _WHOLE), np.float32(_WHOLE * DOWN_GAIN / _FINE), np.float32(1)
    above, beyond = weights[0], weights[1 + GROUP]
    beyond[:] = 0
    for i in range(2 * GROUP - 1, -1, -1):
        if i < GROUP:
            for x in range(beyond.size):
                weights[1 + i, x] = beyond[x]
        for x in range(beyond.size):
            beyond[x] = (one + beyond[x]) * (np.float32(down[first + i, x]) * share)
    for i in range(GROUP):
        for x in range(above.size):
            above[x] = one + above[x] * (np.float32(down[first + i, x]) * share)
            scales[i, x] = np.uint16(np.rint(np.divide(scale, above[x] + weights[1 + i, x])))

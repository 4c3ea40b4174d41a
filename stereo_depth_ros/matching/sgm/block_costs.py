# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Costs of semi-global block matching: Birchfield and Tomasi's of gradients and grays, summed over windows in 16 bits.

Rows are made one after the other. The costs of a pixel are K bytes, one for each disparity in ascending order, K being
the number of disparities rounded up to whole vectors; sums over windows are K words, of which each vector of bytes
gives one with its even and one with its odd disparities. What is behind the last disparity is never used.

Costs and sums are those of OpenCV, with the extension of its borders: the outermost columns have no gradient and the
gray of no gradient; windows repeat the first and the last row of the image, and the first and the last column that has
all disparities in the right image.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import U8, U16
from stereo_depth_ros.core.vectors import (
    BYTES,
    WORDS,
    add,
    add_saturated,
    even_words,
    load,
    maximum,
    minimum,
    odd_words,
    quarter,
    repeat,
    signed,
    store,
    subtract,
    subtract_saturated,
)

__all__ = ["I16", "feature_rows", "move_windows", "padded_count", "pixel_costs"]

I16: TypeAlias = npt.NDArray[np.int16]

_GRADIENT, _GRAY = 0, 3  # rows of features: each with its lower and its upper bound within half a pixel
_ONE = np.uint16(1)


def padded_count(num_disparities: int) -> int:
    """Elements of a buffer for the costs of a pixel: whole vectors."""
    return -(-num_disparities // BYTES) * BYTES


@compiled(allocates=False)
def _gradients(above: U8, here: U8, below: U8, cap: int, out: U8) -> None:
    """Horizontal Sobel responses of a row, clipped to -cap to cap and raised by it."""
    low, high = np.int16(-cap), np.int16(cap)
    for x in range(1, here.size - 1):
        middle = np.int16(np.int16(here[x + 1]) - np.int16(here[x - 1]))
        upper = np.int16(np.int16(above[x + 1]) - np.int16(above[x - 1]))
        lower = np.int16(np.int16(below[x + 1]) - np.int16(below[x - 1]))
        response = np.int16(np.int16(np.int16(middle + middle) + upper) + lower)
        out[x] = np.uint8(np.int16(min(max(response, low), high) + high))


@compiled(allocates=False)
def _bounds(values: U8, low: U8, high: U8) -> None:
    """Minimum and maximum of a row within half a pixel of each pixel."""
    last = values.size - 1
    for x in range(1, last):
        before = np.uint8((np.uint16(values[x]) + np.uint16(values[x - 1])) >> _ONE)
        after = np.uint8((np.uint16(values[x]) + np.uint16(values[x + 1])) >> _ONE)
        low[x] = min(min(before, after), values[x])
        high[x] = max(max(before, after), values[x])
    for x, neighbor in ((0, 1), (last, last - 1)):
        middle = np.uint8((np.uint16(values[x]) + np.uint16(values[neighbor])) >> _ONE)
        low[x] = min(middle, values[x])
        high[x] = max(middle, values[x])


@compiled(allocates=False)
def feature_rows(left: U8, right: U8, y: int, cap: int, own: U8, features: U8) -> None:
    """What the costs of image row ``y`` compare.

    Args:
        left, right: uint8 (H, W).
        cap: limit of the gradients.
        own: uint8 (W,), scratch.
        features: uint8 (2, 6, W + BYTES), receives for the left image and for the right one, whose columns are in
            descending order so that disparities ascend: gradient, its lower and its upper bound; gray and its bounds.
    """
    height, width = left.shape
    for side in range(2):
        image, out = right if side else left, features[side]
        row = image[y]
        _gradients(image[max(y - 1, 0)], row, image[min(y + 1, height - 1)], cap, own)
        for x in range(1, width - 1):
            out[_GRADIENT, x] = own[x]
            out[_GRAY, x] = row[x]
        if side:
            for x in range(1, width - 1):
                out[_GRADIENT, x] = own[width - 1 - x]
                out[_GRAY, x] = row[width - 1 - x]
        for n in range(0, 6, 3):
            out[n, 0] = out[n, width - 1] = np.uint8(cap)
            _bounds(out[n, :width], out[n + 1, :width], out[n + 2, :width])


@compiled(allocates=False)
def _dissimilarity(a: Any, a_low: Any, a_high: Any, b: Any, b_low: Any, b_high: Any) -> Any:
    """Birchfield and Tomasi 1998: the distance of one to the interval of the other, the smaller of both, in bytes."""
    to_b = maximum(subtract_saturated(a, b_high), subtract_saturated(b_low, a))
    to_a = maximum(subtract_saturated(b, a_high), subtract_saturated(a_low, b))
    return minimum(to_b, to_a)


@compiled(allocates=False)
def pixel_costs(features: U8, begin: int, min_disparity: int, count: int, costs: U8) -> None:
    """Costs of the pixels of a row: of their gradients, plus a quarter of those of their grays.

    Args:
        features: of :func:`feature_rows`.
        begin: first left column that has all disparities.
        min_disparity: disparity of index 0, px.
        count: K.
        costs: uint8 (N K,), of N columns.
    """
    left, right = features[0], features[1]
    width = left.shape[1] - BYTES
    g, g_low, g_high = right[_GRADIENT], right[_GRADIENT + 1], right[_GRADIENT + 2]
    i, i_low, i_high = right[_GRAY], right[_GRAY + 1], right[_GRAY + 2]
    for n in range(costs.size // count):
        x = begin + n
        a, a_low, a_high = repeat(left[0, x]), repeat(left[1, x]), repeat(left[2, x])
        b, b_low, b_high = repeat(left[3, x]), repeat(left[4, x]), repeat(left[5, x])
        first = width - 1 - x + min_disparity
        for k in range(0, count, BYTES):
            at = first + k
            gradient = _dissimilarity(a, a_low, a_high, load(g, at), load(g_low, at), load(g_high, at))
            gray = _dissimilarity(b, b_low, b_high, load(i, at), load(i_low, at), load(i_high, at))
            store(costs, n * count + k, add(gradient, quarter(gray)))


@compiled(allocates=False)
def _first_sums(costs: U8, radius: int, sums: U16) -> None:
    """Sums of the costs of a row over the window of its first column."""
    count = sums.size
    sums[:] = 0
    for j in range(-radius, radius + 1):
        for k in range(0, count, BYTES):
            enters = load(costs, max(j, 0) * count + k)
            store(sums, k, add(load(sums, k), even_words(enters)))
            store(sums, k + WORDS, add(load(sums, k + WORDS), odd_words(enters)))


@compiled(allocates=False)
def _next_sums(costs: U8, enters_at: int, leaves_at: int, k: int, sums: U16) -> Any:
    """Move the sums of a row on to the next column, for one vector; the new ones of even and odd disparities."""
    enters, leaves = load(costs, enters_at), load(costs, leaves_at)
    even = subtract(add(load(sums, k), even_words(enters)), even_words(leaves))
    odd = subtract(add(load(sums, k + WORDS), odd_words(enters)), odd_words(leaves))
    store(sums, k, even)
    store(sums, k + WORDS, odd)
    return signed(even), signed(odd)


@compiled(allocates=False)
def _replace(total: Any, plus: Any, minus: Any, plus_first: bool) -> Any:
    if plus_first:
        return subtract_saturated(add_saturated(total, plus), minus)
    return add_saturated(subtract_saturated(total, minus), plus)


@compiled(allocates=False)
def move_windows(
    enters: U8, leaves: U8, new: bool, plus_first: bool, radius: int, sums: U16, before: I16, total: I16
) -> None:
    """Sums over the windows of an image row from those of the row before; they saturate as OpenCV's do.

    Args:
        enters, leaves: uint8 (N K,), costs of the row that enters the windows and of the one that leaves them.
        new: whether the row enters for the first time; then the first column adds it before the other is subtracted.
        plus_first: whether all columns always do so.
        radius: of the window.
        sums: uint16 (2, K), scratch.
        before, total: int16 (N K,), sums over the windows of the previous row, and of this one, written; may be one
            array.
    """
    entering, leaving = sums[0], sums[1]
    count = entering.size
    for side in range(2):
        _first_sums(leaves if side else enters, radius, sums[side])
    for k in range(0, count, WORDS):
        plus, minus = signed(load(entering, k)), signed(load(leaving, k))
        store(total, k, _replace(load(before, k), plus, minus, new or plus_first))
    for at in range(count, enters.size, count):
        enters_at = min(at + radius * count, enters.size - count)
        leaves_at = max(at - (radius + 1) * count, 0)
        for k in range(0, count, BYTES):
            even_in, odd_in = _next_sums(enters, enters_at + k, leaves_at + k, k, entering)
            even_out, odd_out = _next_sums(leaves, enters_at + k, leaves_at + k, k, leaving)
            even, odd = load(before, at + k), load(before, at + k + WORDS)
            store(total, at + k, _replace(even, even_in, even_out, plus_first))
            store(total, at + k + WORDS, _replace(odd, odd_in, odd_out, plus_first))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Zero-mean normalized correlation over windows in space and time, and the disparity of each pixel by it.

With I of the left and J of the right window, n samples each, sums over the window in x, y and t:

    rho = (sum I J - sum I sum J / n) / sqrt((sum I^2 - (sum I)^2 / n) (sum J^2 - (sum J)^2 / n))

All sums are of integers, so that they do not depend on the order of summation.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numba
import numpy as np
import numpy.typing as npt
from numba import float32, float64, int16, int64, uint8, uint32

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8, U16, Reason
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.selection.summed_costs import (
    NO_KEY,
    U32,
    least_key,
    left_right_row,
    lower_keys,
    second_key,
)

__all__ = ["LARGEST_WINDOW", "SPECKLE_STEPS_PER_PX", "STEPS_PER_PX", "WindowOutput", "WindowSearch", "match_rows"]

I32: TypeAlias = npt.NDArray[np.int32]
I64: TypeAlias = npt.NDArray[np.int64]

STEPS_PER_PX = 64
SPECKLE_STEPS_PER_PX = 8  # 4096 disparities fit in 16 bits
LEAST_CORRELATION = 0.5  # below it the windows do not show the same
LEAST_DEVIATION = 0.5  # gray levels, of a window with texture: less is rounding
MIDDLE = 128  # subtracted from the gray levels, so that products fit in 15 bits
LARGEST_WINDOW = (1 << 31) // MIDDLE**2  # samples whose products fit in 32 bits
_COST_STEPS = np.float32(32767)  # of 1 - rho, 0..2, in a key
_INDEX, _TOTAL = np.uint32(0xFFFF), np.uint32(16)
_BORDER, _TEXTURE = np.uint8(Reason.BORDER), np.uint8(Reason.TEXTURE)
_NO_MATCH, _UNIQUENESS = np.uint8(Reason.NO_MATCH), np.uint8(Reason.UNIQUENESS)


class WindowSearch(NamedTuple):
    """Window and search range.

    The images are extended by ``half`` pixels on all sides; ``uniqueness`` is the least share by which the second cost
    exceeds the first; ``tolerance`` is that of the left-right check, px; ramp is 0, 1, 2 ...
    """

    half: int
    max_disparity: int
    uniqueness: float
    tolerance: int
    ramp: U32


class WindowOutput(NamedTuple):
    """Disparities (px), the same in coarse steps for the speckle filter, reasons, margin of the best cost, (H, W)."""

    disparity_px: F32
    coarse: I16
    reasons: U8
    margin: F32


class _Windows(NamedTuple):
    """Statistics of the windows around the pixels of one row, (W,) each."""

    total: F64  # sum I
    squares: F64  # sum I^2 - (sum I)^2 / n
    inverse: F64  # 1 / sqrt(squares), 0 without texture
    next: F64  # the same as squares of the window and of the one a column to the right


@compiled(allocates=False)
def _add_products(left: U8, right: U8, max_disparity: int, sign: int, sums: I32) -> None:
    """Add the products of one row of a pair to ``sums`` (W, K); index k of column x is right column x - max + k."""
    width, count = sums.shape
    for x in range(width):
        at = x - max_disparity
        begin, end = min(max(-at, 0), count), max(min(width - at, count), 0)
        if begin < end:
            value = np.int32(sign * (np.int64(left[x]) - MIDDLE))
            _add_row(value, right[at + begin : at + end], sums[x, begin:end])


@compiled(allocates=False)
def _add_row(value: np.int32, others: U8, sums: I32) -> None:
    for k in range(sums.size):
        product = np.int32(value * np.int32(np.int32(others[k]) - np.int32(MIDDLE)))
        sums[k] = np.int32(sums[k] + product)


@compiled(allocates=False)
def _add_squares(image: U8, sign: int, sums: I64) -> None:
    """Add one row to the sums of each column: of the values, their squares, their products with the next column."""
    last = image.size - 1
    for x in range(image.size):
        here, beside = np.int64(image[x]) - MIDDLE, np.int64(image[min(x + 1, last)]) - MIDDLE
        sums[0, x] += sign * here
        sums[1, x] += sign * here * here
        sums[2, x] += sign * here * beside


@compiled(allocates=False)
def _describe(sums: I64, half: int, samples: int, windows: _Windows) -> None:
    width = windows.total.size
    total = square = product = np.int64(0)
    for x in range(2 * half):
        total, square, product = total + sums[0, x], square + sums[1, x], product + sums[2, x]
    for x in range(width):
        enters = x + 2 * half
        total, square, product = total + sums[0, enters], square + sums[1, enters], product + sums[2, enters]
        windows.total[x] = total
        squares = square - np.float64(total) * total / samples
        windows.squares[x] = squares
        textured = squares > samples * LEAST_DEVIATION * LEAST_DEVIATION
        windows.inverse[x] = 1 / np.sqrt(squares) if textured else 0.0
        beside = total - sums[0, x] + sums[0, min(enters + 1, sums.shape[1] - 1)]
        windows.next[x] = product - np.float64(total) * beside / samples
        total, square, product = total - sums[0, x], square - sums[1, x], product - sums[2, x]


@compiled(allocates=False)
def _add(window: I32, enters: I32) -> None:
    for k in range(window.size):
        window[k] = np.int32(window[k] + enters[k])


@compiled(allocates=False)
def _subtract(window: I32, leaves: I32) -> None:
    for k in range(window.size):
        window[k] = np.int32(window[k] - leaves[k])


@compiled(allocates=False)
def _make_keys(window: I32, mean: float, inverse: float, totals: F64, inverses: F64, ramp: U32, keys: U32) -> None:
    """Keys of a pixel, see summed_costs.py, from the sums of products; the cost is 1 - rho."""
    for k in range(keys.size):
        rho = np.float32((np.float64(window[k]) - mean * totals[k]) * (inverse * inverses[k]))
        cost = min(max(np.float32(1) - rho, np.float32(0)), np.float32(2)) * _COST_STEPS
        keys[k] = np.uint32(np.uint32(np.int32(cost)) << _TOTAL) | ramp[k]


@compiled(allocates=False)
def _between(here: float, beside: float, squares: float, squares_beside: float, product: float) -> tuple[float, float]:
    """Part s, 0..1, of the way to the adjacent right window at which the correlation is highest, and that maximum.

    J is linear between the two windows J0 and J1: J = (1 - s) J0 + s J1. With c = sum I (J1 - J0),
    b = sum J0 (J1 - J0) and e = sum (J1 - J0)^2, the derivative of rho is zero at
    s = (b sum I J0 - c sum J0^2) / (b c - e sum I J0); sums without the mean. (Psarakis and Evangelidis, "An enhanced
    correlation-based method for stereo correspondence with sub-pixel accuracy", ICCV 2005.)

    Args:
        here, beside: sum I J0 and sum I J1.
        squares, squares_beside, product: sum J0^2, sum J1^2 and sum J0 J1.
    """
    best = here / np.sqrt(squares)
    c, b, e = beside - here, product - squares, squares - 2 * product + squares_beside
    divisor = b * c - e * here
    if divisor == 0:
        return 0.0, best
    s = (b * here - c * squares) / divisor
    if not 0 < s < 1:
        return 0.0, best
    power = squares + 2 * s * b + s * s * e
    rho = (here + s * c) / np.sqrt(power) if power > 0 else best
    return (s, rho) if rho > best else (0.0, best)


@compiled(allocates=False)
def _subpixel(window: I32, k: int, at: int, mean: float, right: _Windows) -> float:
    """Sub-pixel part of index ``k``, whose right window is around column ``at``: -1..1."""
    if right.inverse[at] == 0:
        return 0.0
    here = np.float64(window[k]) - mean * right.total[at]
    moved, best = 0.0, 0.0
    for side in (1, -1):
        if 0 <= k + side < window.size and 0 <= at + side < right.total.size and right.inverse[at + side] > 0:
            beside = np.float64(window[k + side]) - mean * right.total[at + side]
            product = right.next[min(at, at + side)]
            s, rho = _between(here, beside, right.squares[at], right.squares[at + side], product)
            if rho > best:
                moved, best = side * s, rho
    return moved


@compiled(allocates=False)
def _take(
    window: I32,
    keys: U32,
    x: int,
    y: int,
    textured: bool,
    mean: float,
    right: _Windows,
    search: WindowSearch,
    output: WindowOutput,
) -> int:
    """The winner of a pixel, or the reason against it; its index."""
    winner = least_key(keys)
    k = int(winner & _INDEX)
    first = np.float32(winner >> _TOTAL)
    rival = second_key(keys, search.ramp, k)
    second = first if rival == NO_KEY else np.float32(rival >> _TOTAL)
    margin = (second - first) / max(second, np.float32(1))
    index = np.rint((k + _subpixel(window, k, x - search.max_disparity + k, mean, right)) * STEPS_PER_PX) / STEPS_PER_PX
    output.disparity_px[y, x] = search.max_disparity - index
    output.coarse[y, x] = np.int16((keys.size - 1 - index) * SPECKLE_STEPS_PER_PX)
    output.margin[y, x] = margin
    reason = np.uint8(0)
    if not textured:
        reason = _TEXTURE
    elif search.uniqueness > 0 and second <= first * (1 + search.uniqueness):
        reason = _UNIQUENESS
    elif first > (1 - LEAST_CORRELATION) * _COST_STEPS:
        reason = _NO_MATCH
    output.reasons[y, x] = reason
    return k


@compiled(allocates=False)
def _winners_row(
    y: int,
    sums: I32,
    samples: int,
    left: _Windows,
    right: _Windows,
    window: I32,
    keys: U32,
    right_keys: U32,
    best: U16,
    search: WindowSearch,
    output: WindowOutput,
) -> None:
    width, count = left.total.size, window.size
    right_keys[:] = NO_KEY
    window[:] = 0
    for x in range(2 * search.half):
        _add(window, sums[x])
    for x in range(width):
        _add(window, sums[x + 2 * search.half])
        at = x - search.max_disparity
        begin, end = min(max(-at, 0), count), max(min(width - at, count), 0)
        if begin < end:
            mean, inverse = left.total[x] / samples, left.inverse[x]
            keys[:begin] = NO_KEY
            keys[end:] = NO_KEY
            totals, inverses = right.total[at + begin : at + end], right.inverse[at + begin : at + end]
            part = slice(begin, end)
            _make_keys(window[part], mean, inverse, totals, inverses, search.ramp[part], keys[part])
            lower_keys(keys, right_keys[x : x + count])
            best[x] = _take(window, keys, x, y, inverse > 0, mean, right, search, output)
        else:
            best[x] = 0
            output.reasons[y, x] = _BORDER
        _subtract(window, sums[x])
    left_right_row(best, right_keys, search.tolerance, output.reasons[y])


_STACK = uint8[:, :, ::1]
_SEARCH = numba.types.NamedTuple([int64, int64, float64, int64, uint32[::1]], WindowSearch)
_OUTPUT = numba.types.NamedTuple([float32[:, ::1], int16[:, ::1], uint8[:, ::1], float32[:, ::1]], WindowOutput)


@compiled(numba.void(int64, int64, _STACK, _STACK, _SEARCH, _OUTPUT))
def match_rows(first: int, last: int, left: U8, right: U8, search: WindowSearch, output: WindowOutput) -> None:
    """Disparities of a band of rows, or the reasons against them.

    Args:
        first, last: rows to write.
        left, right: uint8 (pairs, H + 2 half, W + 2 half), the images extended by their border pixels.
        search: window and search range; index k is disparity ``max_disparity`` - k.
        output: written, (H, W).
    """
    pairs, _, padded = left.shape
    width = padded - 2 * search.half
    side = 2 * search.half + 1
    samples = pairs * side * side
    sums = np.zeros((padded, search.ramp.size), np.int32)
    left_sums, right_sums = np.zeros((3, padded), np.int64), np.zeros((3, padded), np.int64)
    window, keys = np.zeros(search.ramp.size, np.int32), np.zeros(search.ramp.size, np.uint32)
    right_keys, best = np.zeros(width + search.ramp.size, np.uint32), np.zeros(width, np.uint16)
    left_windows = _Windows(np.zeros(width), np.zeros(width), np.zeros(width), np.zeros(width))
    right_windows = _Windows(np.zeros(width), np.zeros(width), np.zeros(width), np.zeros(width))
    for y in range(first - 2 * search.half, last):
        for row, sign in ((y + 2 * search.half, 1), (y - 1, -1)):
            if sign > 0 or y > first:
                for n in range(pairs):
                    _add_products(left[n, row], right[n, row], search.max_disparity, sign, sums)
                    _add_squares(left[n, row], sign, left_sums)
                    _add_squares(right[n, row], sign, right_sums)
        if y >= first:
            _describe(left_sums, search.half, samples, left_windows)
            _describe(right_sums, search.half, samples, right_windows)
            arrays = window, keys, right_keys, best
            _winners_row(y, sums, samples, left_windows, right_windows, *arrays, search, output)

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
LAGS = 4  # of the four windows that a cubic goes through
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
    """Statistics of the windows around the pixels of one row."""

    total: F64  # (W,) sum J
    inverse: F64  # (W,) 1 / sqrt(sum J^2 - (sum J)^2 / n), 0 without texture
    powers: F64  # (lags, W) sum J0 J1 - sum J0 sum J1 / n of the window and of the one 0, 1 ... columns to the right


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
def _add_powers(image: U8, sign: int, sums: I64) -> None:
    """Add one row to the sums of each column: of the values, and of their products with those 0, 1 ... to the right."""
    last = image.size - 1
    for x in range(image.size):
        here = sign * (np.int64(image[x]) - MIDDLE)
        sums[0, x] += here
        for lag in range(len(sums) - 1):
            sums[1 + lag, x] += here * (np.int64(image[min(x + lag, last)]) - MIDDLE)


@compiled(allocates=False)
def _describe(sums: I64, half: int, samples: int, windows: _Windows) -> None:
    width = windows.total.size
    for n in range(len(sums)):
        values = windows.total if n == 0 else windows.powers[n - 1]
        running = np.int64(0)
        for x in range(2 * half):
            running += sums[n, x]
        for x in range(width):
            running += sums[n, x + 2 * half]
            values[x] = running
            running -= sums[n, x]
    for x in range(width):
        for lag in range(len(sums) - 1):
            windows.powers[lag, x] -= windows.total[x] * windows.total[min(x + lag, width - 1)] / samples
        textured = windows.powers[0, x] > samples * LEAST_DEVIATION * LEAST_DEVIATION
        windows.inverse[x] = 1 / np.sqrt(windows.powers[0, x]) if textured else 0.0


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
def _moved(s: float, products: F64, powers: F64) -> float:
    """Correlation, times the root of the power of I, with the right window moved by s, 0..1, towards its neighbor.

    J(s) is the cubic through four right windows (Catmull and Rom 1974), J(s) = sum h_i(s) J_i, so that
    rho(s) = sum h_i sum I J_i / sqrt(sum h_i h_j sum J_i J_j), sums without the mean: no image is interpolated.

    Args:
        products: sum I J_i, (4,).
        powers: sum J_i J_j, (4, 4).
    """
    h = (
        ((1 - 0.5 * s) * s - 0.5) * s,
        (1.5 * s - 2.5) * s * s + 1,
        ((2 - 1.5 * s) * s + 0.5) * s,
        (0.5 * s - 0.5) * s * s,
    )
    product = power = 0.0
    for i in range(4):
        product += h[i] * products[i]
        for j in range(4):
            power += h[i] * h[j] * powers[i, j]
    return product / np.sqrt(power) if power > 0 else -np.inf


@compiled(allocates=False)
def _vertex(before: float, here: float, after: float) -> float:
    """Place of the maximum of a parabola through values at -1, 0 and 1: within -1..1, 0 where there is none."""
    bend = before - 2 * here + after
    return min(max((before - after) / (2 * bend), -1.0), 1.0) if -np.inf < bend < 0 else 0.0


@compiled(allocates=False)
def _highest(products: F64, powers: F64) -> float:
    """The s, 0..1, of the highest correlation: steps of 0.2, a parabola, and another one of steps of 0.05."""
    best, top = 0.0, -np.inf
    for step in range(1, 5):
        rho = _moved(0.2 * step, products, powers)
        if rho > top:
            best, top = 0.2 * step, rho
    best += 0.2 * _vertex(_moved(best - 0.2, products, powers), top, _moved(best + 0.2, products, powers))
    best = min(max(best, 0.05), 0.95)
    before, here = _moved(best - 0.05, products, powers), _moved(best, products, powers)
    return best + 0.05 * _vertex(before, here, _moved(best + 0.05, products, powers))


@compiled(allocates=False)
def _load(window: I32, k: int, at: int, side: int, mean: float, right: _Windows, products: F64, powers: F64) -> bool:
    """Load the windows -1, 0, 1, 2 columns to a side of index ``k``, column ``at``; false if the next one is missing.

    Of the others that are beyond the search range or the image, the last window within is repeated.
    """
    count, width = window.size, right.total.size
    if not (0 <= k + side < count and 0 <= at + side < width) or right.inverse[at] == 0:
        return False
    first = -1 if 0 <= k - side < count and 0 <= at - side < width else 0
    last = 2 if 0 <= k + 2 * side < count and 0 <= at + 2 * side < width else 1
    for i in range(4):
        here = side * min(max(i - 1, first), last)
        products[i] = np.float64(window[k + here]) - mean * right.total[at + here]
        for j in range(4):
            there = side * min(max(j - 1, first), last)
            powers[i, j] = right.powers[abs(here - there), at + min(here, there)]
    return True


@compiled(allocates=False)
def _subpixel(window: I32, k: int, at: int, mean: float, right: _Windows, products: F64, powers: F64) -> float:
    """Sub-pixel part of index ``k``, with the right window around column ``at``: -1..1, 0 where a neighbor is missing.

    The cubic has one derivative at the window itself, which tells the side of the maximum.
    """
    if not _load(window, k, at, 1, mean, right, products, powers):
        return 0.0
    if _moved(0.05, products, powers) >= _moved(-0.05, products, powers):
        return _highest(products, powers)
    return -_highest(products, powers) if _load(window, k, at, -1, mean, right, products, powers) else 0.0


@compiled(allocates=False)
def _take(
    window: I32,
    keys: U32,
    x: int,
    y: int,
    textured: bool,
    mean: float,
    right: _Windows,
    products: F64,
    powers: F64,
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
    at = x - search.max_disparity + k
    moved = _subpixel(window, k, at, mean, right, products, powers)
    index = np.rint((k + moved) * STEPS_PER_PX) / STEPS_PER_PX
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
    products: F64,
    powers: F64,
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
            best[x] = _take(window, keys, x, y, inverse > 0, mean, right, products, powers, search, output)
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
    left_sums, right_sums = np.zeros((2, padded), np.int64), np.zeros((1 + LAGS, padded), np.int64)
    window, keys = np.zeros(search.ramp.size, np.int32), np.zeros(search.ramp.size, np.uint32)
    right_keys, best = np.zeros(width + search.ramp.size, np.uint32), np.zeros(width, np.uint16)
    products, powers = np.zeros(4), np.zeros((4, 4))
    left_windows = _Windows(np.zeros(width), np.zeros(width), np.zeros((1, width)))
    right_windows = _Windows(np.zeros(width), np.zeros(width), np.zeros((LAGS, width)))
    for y in range(first - 2 * search.half, last):
        for row, sign in ((y + 2 * search.half, 1), (y - 1, -1)):
            if sign > 0 or y > first:
                for n in range(pairs):
                    _add_products(left[n, row], right[n, row], search.max_disparity, sign, sums)
                    _add_powers(left[n, row], sign, left_sums)
                    _add_powers(right[n, row], sign, right_sums)
        if y >= first:
            _describe(left_sums, search.half, samples, left_windows)
            _describe(right_sums, search.half, samples, right_windows)
            arrays = window, keys, right_keys, best, products, powers
            _winners_row(y, sums, samples, left_windows, right_windows, *arrays, search, output)

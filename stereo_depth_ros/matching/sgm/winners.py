# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection from the path costs of a pixel: their sums, winner and second best, and the least sums of right pixels.

Sums are words: those of even indices in row 0, those of odd indices in row 1 of an array (2, K / 2), so that bytes
become words without a permutation.
"""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import U8, U16, Reason
from stereo_depth_ros.core.vectors import (
    BYTES,
    WORDS,
    add,
    equal,
    even_words,
    first_lane,
    least_lane,
    load,
    minimum,
    odd_words,
    ramp,
    repeat,
    store,
    sum_of_lanes,
    where_less,
)

__all__ = [
    "NO_SUM",
    "add_diagonals",
    "add_paths",
    "agree_row",
    "first_of",
    "lower_right",
    "second_of",
    "subpixel",
    "take_winner",
    "total_cost",
]

NO_SUM = np.uint16(65535)  # of a disparity outside the right image
_NOTHING, _TWO = np.uint16(0), np.uint16(2)
_LEFT_RIGHT = np.uint8(Reason.LEFT_RIGHT)


@compiled(allocates=False, inlined=False)
def add_diagonals(down: U8, down_row: int, up: U8, up_row: int, x: int, sums: U16) -> None:
    """Sums of the path costs of pixel x of a row over the four diagonals.

    Args:
        down, up: uint8 (3, rows, W, K), of paths from the rows above and from below; the second ones are vertical.
        down_row, up_row: where this row is in them.
        sums: uint16 (2, K / 2), written.
    """
    for k in range(0, down.shape[3], BYTES):
        even, odd = repeat(_NOTHING), repeat(_NOTHING)
        for n in range(0, 3, 2):
            path, other = load(down[n, down_row, x], k), load(up[n, up_row, x], k)
            even = add(even, add(even_words(path), even_words(other)))
            odd = add(odd, add(odd_words(path), odd_words(other)))
        store(sums[0], k // 2, even)
        store(sums[1], k // 2, odd)


@compiled(allocates=False)
def add_paths(
    left: U8,
    left_at: int,
    right: U8,
    right_at: int,
    down: U8,
    down_at: int,
    up: U8,
    up_at: int,
    size: int,
    begin: int,
    end: int,
    diagonals: bool,
    sums: U16,
) -> np.uint16:
    """Sums of the path costs of a pixel, and their minimum, ``NO_SUM`` without any.

    Args:
        left, right, down, up: uint8, paths from the left, the right, above and below, contiguous, K of them from the
            elements ``left_at`` to ``up_at`` on. There may be none from below.
        size: K, or that of the window.
        begin, end: indices inside the right image, end exclusive; others get ``NO_SUM``.
        diagonals: whether ``sums`` has those of other paths, which are added.
        sums: uint16 (2, K / 2), written.
    """
    none = repeat(NO_SUM)
    least = none
    limited, upward, half = begin > 0 or end < size, up.size > 0, sums.shape[1]
    inside = repeat(np.uint16(max(end - begin, 0)))
    for k in range(0, size, BYTES):
        at, other_at = k // 2, half + k // 2
        one, other, third = load(left, left_at + k), load(right, right_at + k), load(down, down_at + k)
        even = add(add(even_words(one), even_words(other)), even_words(third))
        odd = add(add(odd_words(one), odd_words(other)), odd_words(third))
        if upward:
            path = load(up, up_at + k)
            even, odd = add(even, even_words(path)), add(odd, odd_words(path))
        if diagonals:
            even, odd = add(even, load(sums, at)), add(odd, load(sums, other_at))
        if limited:
            even = where_less(add(ramp(), repeat(np.uint16(k - begin))), inside, even, none)
            odd = where_less(add(ramp(), repeat(np.uint16(k + 1 - begin))), inside, odd, none)
        store(sums, at, even)
        store(sums, other_at, odd)
        least = minimum(least, minimum(even, odd))
    return least_lane(least)  # type: ignore[no-any-return]


@compiled(allocates=False)
def first_of(sums: U16, size: int, least: np.uint16) -> int:
    """The first of ``size`` indices with the sum ``least``, which one has."""
    wanted = repeat(least)
    for k in range(0, size // 2, WORDS):
        even = first_lane(equal(load(sums[0], k), wanted))
        odd = first_lane(equal(load(sums[1], k), wanted))
        if min(even, odd) < WORDS:
            return int(min(2 * (k + even), 2 * (k + odd) + 1))
    return 0


@compiled(allocates=False)
def second_of(sums: U16, size: int, best: int) -> np.uint16:
    """The smallest of ``size`` sums at least two indices away from ``best``; ``NO_SUM`` if there is none."""
    none, two = repeat(NO_SUM), repeat(_TWO)
    second = none
    for k in range(0, size // 2, WORDS):
        even = add(ramp(), repeat(np.uint16(2 * k + 1 - best)))  # distance from the index before the best
        odd = add(ramp(), repeat(np.uint16(2 * k + 2 - best)))
        second = minimum(second, where_less(two, even, load(sums[0], k), none))
        second = minimum(second, where_less(two, odd, load(sums[1], k), none))
    return least_lane(second)  # type: ignore[no-any-return]


@compiled(allocates=False)
def take_winner(sums: U16, first: int, size: int, least: np.uint16, x: int, winners: U16) -> None:
    """The winner of pixel x of a row: its index, its sum, the second best, and the sums of both neighbors.

    The values that follow from them are computed for a whole row, in one loop: a branch for each pixel would
    wait for its winner.

    Args:
        sums: uint16 (2, K / 2), of ``size`` indices from ``first`` on.
        least: the smallest of the sums, inside the right image.
        winners: uint16 (5, W), written; ``NO_SUM`` for what does not exist.
    """
    best = first_of(sums, size, least)
    before, after = best - 1, best + 1
    winners[0, x] = first + best
    winners[1, x] = least
    winners[2, x] = second_of(sums, size, best)
    winners[3, x] = sums[before & 1, before >> 1] if before >= 0 else NO_SUM
    winners[4, x] = sums[after & 1, after >> 1] if after < size else NO_SUM


@compiled(allocates=False)
def total_cost(cost: U8, cost_at: int, size: int) -> np.uint32:
    """The sum of the ``size`` costs of a pixel, of a contiguous array from element ``cost_at`` on."""
    total = repeat(np.uint16(0))
    for k in range(cost_at, cost_at + size, BYTES):
        here = load(cost, k)
        total = add(total, add(even_words(here), odd_words(here)))
    return sum_of_lanes(total)  # type: ignore[no-any-return]


@compiled(allocates=False)
def subpixel(before: np.uint16, here: np.uint16, after: np.uint16) -> float:
    """Sub-pixel part of the index, -0.5..0.5: the intersection u of two lines of opposite slope through three costs.

    u is biased towards whole pixels (pixel locking); u (1 + 0.45 (1 - 4 u^2)) compensates it on average (an
    interpolation function after Haller and Nedevschi, "Design of interpolation functions for subpixel-accuracy
    stereo-vision systems", TIP 2012; with a factor fitted to a histogram of real disparities). It is 0 without both
    neighbors.
    """
    one, middle, other = np.float64(before), np.float64(here), np.float64(after)
    height = max(one, other) - middle
    exists = before != NO_SUM and after != NO_SUM and height > 0
    u = np.divide(one - other, 2 * height if exists else 1.0)
    return u * (1.45 - 1.8 * u * u) if exists else 0.0


@compiled(allocates=False)
def lower_right(sums: U16, first: int, size: int, x: int, right_sums: U16, right_indices: U16) -> None:
    """Update the smallest sums of the right pixels, and their indices, with those of left pixel x.

    There are ``size`` of them, from the even index ``first`` on.

    Pixels come from the right to the left, so that of equal sums the one of the smaller index was first and stays.

    Args:
        sums: uint16 (2, K / 2).
        right_sums, right_indices: uint16 (2, (W + K) / 2 + 1), of right pixels, max_disparity columns further: those of
            even columns in row 0.
    """
    same, other, at = x & 1, 1 - (x & 1), x + first
    for k in range(0, size // 2, WORDS):
        index = first + 2 * k
        _lower(load(sums[0], k), np.uint16(index), right_sums[same], right_indices[same], (at >> 1) + k)
        _lower(load(sums[1], k), np.uint16(index + 1), right_sums[other], right_indices[other], ((at + 1) >> 1) + k)


@compiled(allocates=False)
def _lower(sums: object, first: np.uint16, right_sums: U16, right_indices: U16, at: int) -> None:
    before = load(right_sums, at)
    store(right_indices, at, where_less(sums, before, add(ramp(), repeat(first)), load(right_indices, at)))
    store(right_sums, at, minimum(sums, before))


@compiled(allocates=False, inlined=False)
def agree_row(best: U16, right_indices: U16, tolerance: int, reasons: U8) -> None:
    """Mark the pixels of a row whose right pixel prefers a disparity more than ``tolerance`` px away.

    Args:
        best: uint16 (W,), the index of each left pixel; index k of left pixel x is right pixel x + k.
        right_indices: uint16 (2, (W + K) / 2), see :func:`lower_right`.
        reasons: uint8 (W,), 0 where valid.
    """
    for x in range(best.size):
        if reasons[x] == 0:
            k = np.int64(best[x])
            at = x + k
            if abs(np.int64(right_indices[at & 1, at >> 1]) - k) > tolerance:
                reasons[x] = _LEFT_RIGHT

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global block matching: costs of windows summed along paths in 16 bits, winners and left-right check.

L(p, d) = C(p, d) + min(L(p-r, d), L(p-r, d +- 1) + P1, min_k L(p-r, k) + P2) - min_k L(p-r, k)
(Hirschmueller, "Stereo processing by semiglobal matching and mutual information", PAMI 2008, equation 13), with the
arithmetic of OpenCV's StereoSGBM, also where it saturates: C includes P2, paths begin from zero.

Costs of a pixel are in the order of block_costs.py: of each 2 n disparities, the even ones, then the odd ones. The
neighbors of a vector of disparities are then another vector, and this one moved by one lane.

Paths from the row above are written over those of that row. A diagonal one moves by a column from row to row, so its
place is a column minus or plus the number of the row, around the end of the buffer.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numba import int16, int64, uint8, uint16

from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.page_memory import on_pages
from stereo_depth_ros.core.types import U8, U16
from stereo_depth_ros.core.vectors import (
    BYTES,
    WORDS,
    add,
    add_saturated,
    at_most,
    bit_count,
    equal,
    first_lane,
    last_lane,
    least_lane,
    load,
    maximum,
    minimum,
    next_lanes,
    previous_lanes,
    repeat,
    store,
    subtract_saturated,
)
from stereo_depth_ros.matching.sgm.block_costs import (
    I16,
    feature_rows,
    move_windows,
    padded_count,
    pixel_costs,
)

__all__ = ["LARGEST", "BlockScratch", "BlockSearch", "match_blocks"]

LARGEST = np.int16(2**15 - 1)
_LEAST = np.int16(-(2**15))
_ZERO = np.int16(0)
_STEPS = 16  # per px
_NOWHERE = 1 << 20
_OPENCV_LANES = 8
_EVERY_FOURTH = np.uint64(0x11111111)  # bits of the even or odd disparities of a lane


class BlockSearch(NamedTuple):
    """Parameters of a search, as OpenCV uses them."""

    begin: int  # first left column with all disparities in the right image
    min_disparity: int
    num_disparities: int
    cap: int
    radius: int
    P1: np.int16
    P2: np.int16
    uniqueness: int  # percent
    tolerance: int  # of the left-right check, px
    directions: int  # 3 or 5, the last one from the right, or 8


class BlockScratch(NamedTuple):
    """Buffers for images of N columns with all disparities, K per pixel."""

    own: U8  # (W,)
    features: U8  # (2, 6, W + BYTES) see feature_rows
    pixels: U8  # (rows of a window + 2, N K) costs of pixels; zeros in the last row
    sums: U16  # (2, K) see move_windows
    windows: I16  # (1 or H, N K) costs of windows
    totals: I16  # (1 or H, N K) sums of path costs
    along: I16  # (K,) path costs from the left or right
    above: I16  # (3, N K) path costs from the row before, from the left, straight and from the right
    least: I16  # (3, N) their minima
    unused: I16  # (K,) LARGEST where there is no disparity, else the lowest number
    lowest: I16  # (N,) lowest sum of each pixel
    limits: I16  # (N,) see _set_limits
    best: I16  # (N,) index of the disparity with the lowest sum, and the sums of its neighbors
    before: I16
    after: I16
    unique: U8  # (N,) whether it is the winner
    right_total: I16  # (W,) the lowest sum of each right pixel, and its disparity, px
    right: I16

    @classmethod
    def allocate(cls, height: int, width: int, search: BlockSearch) -> BlockScratch:
        """Buffers for images of this size."""
        count = padded_count(search.num_disparities)
        columns = width + min(0, search.min_disparity) - search.begin
        row = columns * count
        rows = height if search.directions == 8 else 1
        index = np.arange(count)
        disparity = index // BYTES * BYTES + index % WORDS * 2 + index % BYTES // WORDS
        return cls(
            own=np.empty(width, np.uint8),
            features=np.zeros((2, 6, width + BYTES), np.uint8),
            pixels=on_pages((2 * search.radius + 3, row), np.uint8),
            sums=on_pages((2, count), np.uint16),
            windows=on_pages((rows, row), np.int16),
            totals=on_pages((rows, row), np.int16),
            along=on_pages((count,), np.int16),
            above=on_pages((3, row), np.int16),
            least=np.zeros((3, columns), np.int16),
            unused=np.where(disparity < search.num_disparities, _LEAST, LARGEST),
            lowest=np.empty(columns, np.int16),
            limits=np.empty(columns, np.int16),
            best=np.empty(columns, np.int16),
            before=np.empty(columns, np.int16),
            after=np.empty(columns, np.int16),
            unique=np.empty(columns, np.uint8),
            right_total=np.empty(width, np.int16),
            right=np.empty(width, np.int16),
        )


@compiled(allocates=False)
def _lower(near: Any, here: Any, delta: Any, P1: Any, cost: Any) -> Any:
    """Path costs of a pixel from those of the pixel before, their lower neighbors and their minimum plus P2."""
    lowest = minimum(minimum(here, add_saturated(near, P1)), delta)
    return add_saturated(subtract_saturated(lowest, delta), cost)


@compiled(allocates=False)
def _step(
    path: I16, at: int, last: bool, even: Any, before: Any, delta: Any, P1: Any, even_cost: Any, odd_cost: Any
) -> Any:
    """A step of a path for the two vectors at ``at``, before which are ``even`` and the last odd one, ``before``.

    Returns the new path costs of even and of odd disparities, and ``before`` and ``even`` for the next two vectors.
    """
    odd = load(path, at + WORDS)
    after = repeat(LARGEST) if last else load(path, at + BYTES)
    new_even = _lower(minimum(previous_lanes(odd, before), odd), even, delta, P1, even_cost)
    new_odd = _lower(minimum(even, next_lanes(even, after)), odd, delta, P1, odd_cost)
    return new_even, new_odd, odd, after


@compiled(allocates=False)
def _turn(x: int, width: int) -> int:
    if x < 0:
        return x + width
    if x >= width:
        return x - width
    return x


@compiled(allocates=False)
def _sum_paths(t: int, back: bool, search: BlockSearch, s: BlockScratch, windows: I16, totals: I16) -> None:
    """Sums over the paths from the row before and along the row.

    Args:
        t: number of the row, counted from the first or, if ``back``, from the last one.
        back: paths from below and from the right, added to the sums.
    """
    count = s.along.size
    width = windows.size // count
    padded = count > search.num_disparities
    along, left, straight, right = s.along, s.above[0], s.above[1], s.above[2]
    top, P1, P2 = repeat(LARGEST), repeat(search.P1), repeat(search.P2)
    turn = t % width
    start_left, start_right = _turn(-turn, width) * count, _turn(width - 1 + turn, width) * count
    along[:] = 0
    left[start_left : start_left + count] = 0
    right[start_right : start_right + count] = 0
    s.least[0, start_left // count] = 0
    s.least[2, start_right // count] = 0
    least = _ZERO
    for i in range(width):
        x = width - 1 - i if back else i
        x_left, x_right = _turn(x - turn, width), _turn(x + turn, width)
        at_left, at_right, at = x_left * count, x_right * count, x * count
        delta = add(repeat(least), P2)
        delta_left = add(repeat(s.least[0, x_left]), P2)
        delta_straight = add(repeat(s.least[1, x]), P2)
        delta_right = add(repeat(s.least[2, x_right]), P2)
        low, low_left, low_straight, low_right = top, top, top, top
        before, before_left, before_straight, before_right = top, top, top, top
        even, even_left = load(along, 0), load(left, at_left)
        even_straight, even_right = load(straight, at), load(right, at_right)
        for k in range(0, count, BYTES):
            last = k + BYTES == count
            c_even, c_odd = load(windows, at + k), load(windows, at + k + WORDS)
            e0, o0, before, even = _step(along, k, last, even, before, delta, P1, c_even, c_odd)
            e1, o1, before_left, even_left = _step(
                left, at_left + k, last, even_left, before_left, delta_left, P1, c_even, c_odd
            )
            e2, o2, before_straight, even_straight = _step(
                straight, at + k, last, even_straight, before_straight, delta_straight, P1, c_even, c_odd
            )
            e3, o3, before_right, even_right = _step(
                right, at_right + k, last, even_right, before_right, delta_right, P1, c_even, c_odd
            )
            if padded and last:
                e, o = load(s.unused, k), load(s.unused, k + WORDS)
                e0, e1, e2, e3 = maximum(e0, e), maximum(e1, e), maximum(e2, e), maximum(e3, e)
                o0, o1, o2, o3 = maximum(o0, o), maximum(o1, o), maximum(o2, o), maximum(o3, o)
            store(along, k, e0)
            store(along, k + WORDS, o0)
            store(left, at_left + k, e1)
            store(left, at_left + k + WORDS, o1)
            store(straight, at + k, e2)
            store(straight, at + k + WORDS, o2)
            store(right, at_right + k, e3)
            store(right, at_right + k + WORDS, o3)
            low = minimum(low, minimum(e0, o0))
            low_left = minimum(low_left, minimum(e1, o1))
            low_straight = minimum(low_straight, minimum(e2, o2))
            low_right = minimum(low_right, minimum(e3, o3))
            t_even, t_odd = e0, o0
            if back:
                t_even = add_saturated(load(totals, at + k), e0)
                t_odd = add_saturated(load(totals, at + k + WORDS), o0)
            store(totals, at + k, add_saturated(add_saturated(add_saturated(t_even, e1), e2), e3))
            store(totals, at + k + WORDS, add_saturated(add_saturated(add_saturated(t_odd, o1), o2), o3))
        least = least_lane(low)
        s.least[0, x_left] = least_lane(low_left)
        s.least[1, x] = least_lane(low_straight)
        s.least[2, x_right] = least_lane(low_right)


@compiled(allocates=False)
def _sum_two_paths(search: BlockSearch, s: BlockScratch, windows: I16, totals: I16) -> None:
    """The path from the left, as the first part of the sums, and the one straight from the row before."""
    count, width = s.along.size, s.lowest.size
    padded = count > search.num_disparities
    along, straight = s.along, s.above[1]
    top, P1, P2 = repeat(LARGEST), repeat(search.P1), repeat(search.P2)
    along[:] = 0
    least = _ZERO
    for x in range(width):
        at = x * count
        delta, delta_straight = add_saturated(repeat(least), P2), add_saturated(repeat(s.least[1, x]), P2)
        low, low_straight, before, before_straight = top, top, top, top
        even, even_straight = load(along, 0), load(straight, at)
        for k in range(0, count, BYTES):
            last = k + BYTES == count
            c_even, c_odd = load(windows, at + k), load(windows, at + k + WORDS)
            e0, o0, before, even = _step(along, k, last, even, before, delta, P1, c_even, c_odd)
            e2, o2, before_straight, even_straight = _step(
                straight, at + k, last, even_straight, before_straight, delta_straight, P1, c_even, c_odd
            )
            if padded and last:
                e, o = load(s.unused, k), load(s.unused, k + WORDS)
                e0, o0, e2, o2 = maximum(e0, e), maximum(o0, o), maximum(e2, e), maximum(o2, o)
            store(along, k, e0)
            store(along, k + WORDS, o0)
            store(straight, at + k, e2)
            store(straight, at + k + WORDS, o2)
            store(totals, at + k, e0)
            store(totals, at + k + WORDS, o0)
            low, low_straight = minimum(low, minimum(e0, o0)), minimum(low_straight, minimum(e2, o2))
        least = least_lane(low)
        s.least[1, x] = least_lane(low_straight)


@compiled(allocates=False)
def _finish_sums(search: BlockSearch, s: BlockScratch, windows: I16, totals: I16) -> None:
    """Add the path from the right, unless it is there, and find the lowest sum of each pixel of a row.

    Of three directions, the one straight from the row before is added here too.
    """
    count, width = s.along.size, s.lowest.size
    three, straight = search.directions == 3, s.above[1]
    padded = count > search.num_disparities
    along = s.along
    along[:] = 0
    top, P1, P2 = repeat(LARGEST), repeat(search.P1), repeat(search.P2)
    least = _ZERO
    for i in range(width):
        x = width - 1 - i
        at = x * count
        delta = add_saturated(repeat(least), P2) if three else add(repeat(least), P2)
        low, lowest, before = top, top, top
        even = load(along, 0)
        for k in range(0, count, BYTES):
            t_even, t_odd = load(totals, at + k), load(totals, at + k + WORDS)
            if search.directions != 8:
                last = k + BYTES == count
                c_even, c_odd = load(windows, at + k), load(windows, at + k + WORDS)
                e, o, before, even = _step(along, k, last, even, before, delta, P1, c_even, c_odd)
                if padded and last:
                    e, o = maximum(e, load(s.unused, k)), maximum(o, load(s.unused, k + WORDS))
                store(along, k, e)
                store(along, k + WORDS, o)
                low = minimum(low, minimum(e, o))
                t_even, t_odd = add_saturated(t_even, e), add_saturated(t_odd, o)
                if three:
                    t_even = add_saturated(t_even, load(straight, at + k))
                    t_odd = add_saturated(t_odd, load(straight, at + k + WORDS))
                store(totals, at + k, t_even)
                store(totals, at + k + WORDS, t_odd)
            lowest = minimum(lowest, minimum(t_even, t_odd))
        least = least_lane(low)
        s.lowest[x] = least_lane(lowest)


@compiled(allocates=False)
def _set_limits(uniqueness: int, lowest: I16, limits: I16) -> None:
    """Limits of sums that are too near to the lowest: S (100 - uniqueness) < 100 lowest is S <= limit.

    All sums are where there is no winner, because all of them saturate or nothing but 0 is unique.
    """
    share = np.float32(100 - uniqueness)
    for x in range(lowest.size):
        least = np.float32(lowest[x])
        if share > 0:
            limit = np.floor((np.float32(100) * least - np.float32(1)) / share)  # exact below LARGEST
        else:
            limit = np.float32(LARGEST) if least > 0 else np.float32(_LEAST)
        if lowest[x] == LARGEST:
            limit = np.float32(LARGEST)
        limits[x] = np.int16(np.int32(min(max(limit, np.float32(_LEAST)), np.float32(LARGEST))))


@compiled(allocates=False)
def _set_limits_of_three(uniqueness: int, lowest: I16, limits: I16) -> None:
    """As :func:`_set_limits`, but S <= 100 lowest / (100 - uniqueness), whose next integer wraps around in 16 bits."""
    share = np.float32(100 - uniqueness)
    for x in range(lowest.size):
        ratio = np.int32(np.float32(100) * np.float32(lowest[x]) / share)  # exact, rounded to 0
        above = np.int32(np.int16(np.int32(ratio + np.int32(1))))
        limits[x] = np.int16(max(np.int32(above - np.int32(1)), np.int32(_LEAST))) if uniqueness > 0 else _LEAST


@compiled(allocates=False)
def _place(d: int) -> int:
    """Index of a disparity among the sums of a pixel."""
    return (d & -BYTES) + (d & 1) * WORDS + ((d & (BYTES - 1)) >> 1)


@compiled(allocates=False)
def _take_of_equals(totals: I16, at: int, least: np.int16, search: BlockSearch, count: int) -> int:
    """Which of several lowest sums OpenCV takes of three directions: d mod 8 are lanes, of each it keeps the last."""
    if least == LARGEST:
        return search.num_disparities - _OPENCV_LANES
    lowest = repeat(least)
    best = _NOWHERE
    for odd in range(2):
        seen = np.uint64(0)
        for j in range(0, count, BYTES):
            k = count - BYTES - j
            bits = equal(load(totals, at + k + odd * WORDS), lowest) & ~seen
            while bits:
                lane = last_lane(bits)
                lanes = _EVERY_FOURTH << np.uint64(lane & 3)
                seen |= lanes
                bits &= ~lanes
                best = min(best, k + 2 * lane + odd)
    return best


@compiled(allocates=False)
def _find_winners(search: BlockSearch, s: BlockScratch, totals: I16) -> None:
    """Of each pixel of a row the first disparity with the lowest sum, its neighbors, and whether no other is as near.

    Nearly without branches, which a processor could not predict.
    """
    count, end, three = s.along.size, search.num_disparities - 1, search.directions == 3
    for x in range(s.lowest.size):
        at = x * count
        lowest, limits = repeat(s.lowest[x]), repeat(s.limits[x])
        d, near, equals = _NOWHERE, 0, 0
        for k in range(0, count, BYTES):
            t_even, t_odd = load(totals, at + k), load(totals, at + k + WORDS)
            even_bits, odd_bits = equal(t_even, lowest), equal(t_odd, lowest)
            even, odd = first_lane(even_bits), first_lane(odd_bits)
            nowhere = ((even & odd) >> 6) * _NOWHERE  # at 64
            d = min(d, k + min(2 * even, 2 * odd + 1) + nowhere)
            near += bit_count(at_most(t_even, limits)) + bit_count(at_most(t_odd, limits))
            equals += bit_count(even_bits) + bit_count(odd_bits)
        if three and equals > 1:
            d = _take_of_equals(totals, at, s.lowest[x], search, count)
        before, after = totals[at + _place(max(d - 1, 0))], totals[at + _place(min(d + 1, end))]
        limit = s.limits[x]
        own = int(s.lowest[x] <= limit) + int(d > 0) * int(before <= limit) + int(d < end) * int(after <= limit)
        s.best[x] = np.int16(d)
        s.before[x], s.after[x] = before, after
        s.unique[x] = np.uint8(near == own)


@compiled(allocates=False)
def _set_right(search: BlockSearch, s: BlockScratch) -> None:
    """The left pixel with the lowest sum for each right pixel of a row; of equal ones the one most to the right."""
    s.right[:] = np.int16((search.min_disparity - 1) * _STEPS)
    s.right_total[:] = LARGEST
    for i in range(s.best.size):
        x = s.best.size - 1 - i
        disparity = int(s.best[x]) + search.min_disparity
        at = search.begin + x - disparity
        total, least = s.right_total[at], s.lowest[x]
        better = s.unique[x] != 0 and total > least
        s.right_total[at] = least if better else total
        s.right[at] = np.int16(disparity) if better else s.right[at]


@compiled(allocates=False)
def _set_disparities(search: BlockSearch, s: BlockScratch, disparity: I16) -> None:
    """Sub-pixel disparities of the winners of a row, by a parabola through three sums."""
    invalid = np.int32((search.min_disparity - 1) * _STEPS)
    first, end = np.int32(search.min_disparity * _STEPS), np.int16(search.num_disparities - 1)
    disparity[:] = np.int16(invalid)
    row = disparity[search.begin : search.begin + s.best.size]
    for x in range(s.best.size):
        before, after, best = np.int32(s.before[x]), np.int32(s.after[x]), s.best[x]
        curvature = max(np.int32(np.int32(before + after) - np.int32(2 * np.int32(s.lowest[x]))), np.int32(1))
        slope = np.int32(np.int32(np.int32(before - after) * np.int32(_STEPS)) + curvature)
        part = np.int32(np.float32(slope) / np.float32(np.int32(2 * curvature)))  # exact, rounded to 0
        inside = best > 0 and best < end
        steps = np.int32(np.int32(np.int32(best) * np.int32(_STEPS)) + (part if inside else np.int32(0)))
        row[x] = np.int16(np.int32(steps + first) if s.unique[x] else invalid)


@compiled(allocates=False)
def _disagrees(x: int, d: int, search: BlockSearch, right: I16) -> bool:
    at = x - d
    if at < 0 or at >= right.size or right[at] < search.min_disparity:
        return False
    return bool(abs(int(right[at]) - d) > search.tolerance)


@compiled(allocates=False)
def _check_left_right(search: BlockSearch, s: BlockScratch, disparity: I16) -> None:
    """Invalidate disparities that the right pixels of both neighboring whole disparities contradict."""
    invalid = np.int16((search.min_disparity - 1) * _STEPS)
    for x in range(search.begin, disparity.size):
        steps = int(disparity[x])
        if steps != invalid:
            lower, upper = steps >> 4, (steps + _STEPS - 1) >> 4
            if _disagrees(x, lower, search, s.right) and _disagrees(x, upper, search, s.right):
                disparity[x] = invalid


@compiled(allocates=False)
def _sum_windows(left: U8, right: U8, y: int, top: int, known: int, search: BlockSearch, s: BlockScratch) -> int:
    """Sums over the windows of image row ``y``, after those of the row before.

    Args:
        top: the first row, which windows repeat.
        known: the first row that has no costs yet; the new one is returned.
    """
    height, ring, r = len(left), len(s.pixels) - 1, search.radius
    total, before = s.windows[y % len(s.windows)], s.windows[max(y - 1, top) % len(s.windows)]
    if y == top:
        total[:] = search.P2
    for k in range(y + r if y > top else top - r, y + r + 1):  # rows that enter
        row = min(max(k, top), height - 1)
        costs, leaves = s.pixels[row % ring], s.pixels[max(y - r - 1, top) % ring if y > top else ring]
        new = row == known
        if new:
            feature_rows(left, right, row, search.cap, s.own, s.features)
            pixel_costs(s.features, search.begin, search.min_disparity, s.along.size, costs)
            known += 1
        move_windows(costs, leaves, new, search.directions == 3, r, s.sums, before, total)
    return known


_SEARCH = numba.types.NamedTuple([int64] * 5 + [int16, int16, int64, int64, int64], BlockSearch)
_SCRATCH = numba.types.NamedTuple(
    [
        *(uint8[::1], uint8[:, :, ::1], uint8[:, ::1], uint16[:, ::1], int16[:, ::1], int16[:, ::1]),
        *(int16[::1], int16[:, ::1], int16[:, ::1], int16[::1]),
        *(int16[::1], int16[::1], int16[::1], int16[::1], int16[::1], uint8[::1], int16[::1], int16[::1]),
    ],
    BlockScratch,
)


@compiled(
    numba.void(int64, int64, int64, READ_ONLY_U8, READ_ONLY_U8, _SEARCH, _SCRATCH, int16[:, ::1]), allocates=False
)
def match_blocks(
    top: int,
    first: int,
    last: int,
    left: U8,
    right: U8,
    search: BlockSearch,
    scratch: BlockScratch,
    disparity_x16: I16,
) -> None:
    """Disparities of image rows ``first`` to ``last``, last exclusive, of paths and windows that begin at row ``top``.

    Args:
        top, first, last: with eight directions, all rows.
        left, right: uint8 (H, W).
        search: the parameters.
        scratch: of a size with the images.
        disparity_x16: int16 (H, W), in 1/16 px, receives in these rows ``16 (min_disparity - 1)`` where there is none.
    """
    s = scratch
    known, ways = top, 2 if search.directions == 8 else 1
    if s.lowest.size == 0:
        disparity_x16[first:last] = np.int16((search.min_disparity - 1) * _STEPS)
        return
    for back in range(ways):
        s.above[:] = 0
        s.least[:] = 0
        for t in range(last - top):
            y = last - 1 - t if back else top + t
            windows, totals = s.windows[y % len(s.windows)], s.totals[y % len(s.totals)]
            if not back:
                known = _sum_windows(left, right, y, top, known, search, s)
            if search.directions == 3:
                _sum_two_paths(search, s, windows, totals)
            else:
                _sum_paths(t, back > 0, search, s, windows, totals)
            if back == ways - 1 and y >= first:
                _finish_sums(search, s, windows, totals)
                if search.directions == 3:
                    _set_limits_of_three(search.uniqueness, s.lowest, s.limits)
                else:
                    _set_limits(search.uniqueness, s.lowest, s.limits)
                _find_winners(search, s, totals)
                _set_right(search, s)
                _set_disparities(search, s, disparity_x16[y])
                _check_left_right(search, s, disparity_x16[y])

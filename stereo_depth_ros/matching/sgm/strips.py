# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching of strips of rows: costs, paths, sums and winners, in cache-sized buffers."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numba import boolean, float32, float64, int16, int64, uint8, uint16, uint32

from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.page_memory import on_pages
from stereo_depth_ros.core.types import F32, U8, U16, Reason
from stereo_depth_ros.core.vectors import BYTES
from stereo_depth_ros.matching.costs.census import LARGEST_COST, padded_count
from stereo_depth_ros.matching.costs.features import copy_costs
from stereo_depth_ros.matching.costs.permeability import GROUP
from stereo_depth_ros.matching.costs.prior import PRIOR_COSTS, PriorCosts, add_prior_costs
from stereo_depth_ros.matching.costs.windows import TILE_ROWS, Windows, fill_missing, run_of, window_at
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.selection.summed_costs import U32
from stereo_depth_ros.matching.sgm.cost_rows import COSTS, RAW_ROWS, SLOTS, VIEW, Costs, View, cost_rows, first_needed
from stereo_depth_ros.matching.sgm.path_costs import LARGEST_PATH_COST, path_step, start_path, step_row
from stereo_depth_ros.matching.sgm.winners import (
    NO_SUM,
    add_diagonals,
    add_paths,
    agree_row,
    first_of,
    lower_right,
    subpixel,
    take_winner,
    total_cost,
)

__all__ = ["SPECKLE_STEPS_PER_PX", "STEPS_PER_PX", "Output", "Scratch", "Search", "match_strips"]

STEPS_PER_PX = 64
SPECKLE_STEPS_PER_PX = 8  # 4096 disparities fit in 16 bits
_TOP = np.uint8(LARGEST_PATH_COST)
_BORDER, _UNIQUENESS = np.uint8(Reason.BORDER), np.uint8(Reason.UNIQUENESS)
_ROWS = GROUP  # A step along a row waits for the one before it; steps in several rows do not wait for each other.
# Costs that are smoothed over many pixels without texture are alike, and paths add up their chance differences. So the
# cost of a winner must lie below the mean of its pixel by this share and these half bits.
CONTRAST, CONTRAST_HALF_BITS = np.float32(0.07), np.float32(1.0)
NARROW = 2.5  # times as large as with the whole range; by Venus, Cones, Art, Aloe, Bowling1 and Motorcycle
_UP_ROWS, _UP_MASK = 8, 7  # a power of two above _ROWS: row y is at y & 7, as a division in every step takes long


class Search(NamedTuple):
    """Search range and checks.

    ``uniqueness`` is the minimum margin over the second best, ``tolerance`` that of the left-right check in px; P2 is
    indexed by the gray difference of neighbors; vertical paths start ``approach_rows``, a multiple of ``_ROWS``,
    before the strip. ``edge_aware`` see cost_rows.py. ``indices_only`` finds the winners and nothing else of them;
    otherwise ``own_right`` leaves the left-right check to who has matched the right image on its own.
    """

    max_disparity: int
    disparities: int
    uniqueness: float
    tolerance: int
    P1: np.uint8
    P2: U8
    approach_rows: int
    edge_aware: bool
    indices_only: bool
    own_right: bool


class Scratch(NamedTuple):
    """Buffers of a strip.

    There are 1 or 3 directions from the rows above, and as many from below or none; K disparities are whole vectors.
    Without paths from below, ``_ROWS`` rows are enough.
    """

    costs: Costs
    cost: U8  # (rows, W, K) matching costs
    down: U8  # (directions, rows, W, K) path costs from above
    up: U8  # (directions, _UP_ROWS, W, K) path costs from below, of the latest rows
    left: U8  # (_ROWS, W, K) path costs from the left
    right: U8  # (_ROWS, K) path costs from the right, of the latest pixels
    least: U8  # (_ROWS,) minimum path cost of the latest pixels along each row
    least_down: U8  # (directions, 2, W) minimum path cost of each pixel, of two alternating rows
    least_up: U8
    totals: U16  # (_ROWS, 2, K / 2) see winners.py
    least_totals: U16  # (_ROWS,)
    sums_of_costs: U32  # (_ROWS, W)
    right_sums: U16  # (_ROWS, 2, (W + K) / 2 + 1) see lower_right
    right_indices: U16
    winners: U16  # (_ROWS, 5, W) see take_winner

    @classmethod
    def allocate(cls, rows: int, width: int, disparities: int, paths: int, edge_aware: bool) -> Scratch:
        """Buffers for strips of up to ``rows`` rows, warm-up included, and ``width`` columns; 3, 4 or 8 paths."""
        count = padded_count(disparities)
        down, up = {3: (1, 0), 4: (1, 1), 8: (3, 3)}[paths]
        rows = rows + _ROWS if up else _ROWS  # costs are written in groups
        smoothed = width if edge_aware else 1
        unused = on_pages((count,), np.uint8)
        unused[disparities:] = LARGEST_COST
        return cls(
            costs=Costs(
                raw=on_pages((RAW_ROWS, width + 2, count), np.uint8),
                sums=on_pages((count,), np.uint16),
                smooth=on_pages((SLOTS, width, count), np.uint8),
                forward=on_pages((RAW_ROWS, smoothed + 1, count), np.uint16),
                backward=on_pages((RAW_ROWS, count), np.uint16),
                above=on_pages((smoothed, count), np.uint16),
                below=on_pages((GROUP, BYTES), np.uint16),
                moved=on_pages((count,), np.uint16),
                weights=on_pages((2 + GROUP, smoothed), np.float32),
                scales=on_pages((GROUP, smoothed), np.uint16),
                unused=unused,
            ),
            cost=on_pages((rows, width, count), np.uint8),
            down=on_pages((down, rows, width, count), np.uint8),
            up=on_pages((up, _UP_ROWS, width, count), np.uint8),
            left=on_pages((_ROWS, width, count), np.uint8),
            right=on_pages((_ROWS, count), np.uint8),
            least=on_pages((_ROWS,), np.uint8),
            least_down=on_pages((down, 2, width), np.uint8),
            least_up=on_pages((up, 2, width), np.uint8),
            totals=on_pages((_ROWS, 2, count // 2), np.uint16),
            least_totals=on_pages((_ROWS,), np.uint16),
            sums_of_costs=on_pages((_ROWS, width), np.uint32),
            right_sums=on_pages((_ROWS, 2, (width + count) // 2 + 1), np.uint16),
            right_indices=on_pages((_ROWS, 2, (width + count) // 2 + 1), np.uint16),
            winners=on_pages((_ROWS, 5, width), np.uint16),
        )


class Output(NamedTuple):
    """Disparities (px, unfiltered), in coarse steps for the speckle filter too, reasons, margin and indices, (H, W)."""

    disparity_px: F32
    coarse: I16
    reasons: U8
    margin: F32
    indices: U16


@compiled(allocates=False, inlined=False)
def _finish_row(winners: U16, y: int, search: Search, output: Output) -> None:
    """Disparities and margins of a row of winners."""
    disparity_px, coarse, margins, reasons = (
        output.disparity_px[y],
        output.coarse[y],
        output.margin[y],
        output.reasons[y],
    )
    best, least, rivals, before, after = winners[0], winners[1], winners[2], winners[3], winners[4]
    highest, last = search.max_disparity, search.disparities - 1
    lowest = np.float32(highest - last)
    for x in range(disparity_px.size):  # three loops, as the compiler has no vectors for one of so many rows
        inside = best[x] > 0 and best[x] < last
        part = subpixel(before[x] if inside else NO_SUM, least[x], after[x] if inside else NO_SUM)
        index = np.rint((best[x] + part) * STEPS_PER_PX) * (1 / STEPS_PER_PX)
        disparity_px[x] = highest - index
    for x in range(disparity_px.size):
        coarse[x] = np.int16((disparity_px[x] - lowest) * np.float32(SPECKLE_STEPS_PER_PX))
    for x in range(disparity_px.size):
        first = np.float32(least[x])
        second = first if rivals[x] == NO_SUM else np.float32(rivals[x])  # without a second candidate the margin is 0
        margin = np.divide(second - first, max(second, np.float32(1)))
        margins[x] = margin
        unsure = _UNIQUENESS if margin < search.uniqueness else np.uint8(0)
        reasons[x] = _BORDER if least[x] == NO_SUM else unsure


@compiled(allocates=False)
def _reject_alike(
    cost: U8, best: U16, sums: U32, windows: Windows, tile: int, search: Search, margin: F32, reasons: U8
) -> None:
    """Mark the pixels of a row whose winner costs hardly less than their other disparities do on average.

    A window has fewer of them, so that a pixel without a right match has a rival less often: its margin must be larger.
    """
    for run in range(windows.run_count[tile]):
        start, end, low, some = run_of(windows, tile, run)
        filled = max(low + some - search.disparities, 0)  # those that only fill a vector
        least_margin = NARROW * search.uniqueness if some < search.disparities else 0.0
        unused, share = filled * np.int64(LARGEST_COST), np.float32(1) / np.float32(some - filled)
        for x in range(start, end):
            mean = np.float32(np.int64(sums[x]) - unused) * share
            contrast = mean - np.float32(cost[x, best[x]])
            alike = contrast < max(CONTRAST * mean, CONTRAST_HALF_BITS) or margin[x] < least_margin
            if reasons[x] == 0 and alike:
                reasons[x] = _UNIQUENESS


@compiled(allocates=False, inlined=False)
def _winners_rows(
    first: int, last: int, top: int, image: U8, windows: Windows, search: Search, scratch: Scratch, output: Output
) -> None:
    """Paths along rows first to last, at most ``_ROWS``, last exclusive, and the winners of all sums.

    Row y is at y - top in the buffers of costs and of paths from above.
    """
    s = scratch
    width, size, rows = image.shape[1], s.cost.shape[2], last - first
    costs, ups = (first - top) * width, len(s.up) > 0
    tile = first // TILE_ROWS
    for run in range(windows.run_count[tile]):
        start, stop, low, some = run_of(windows, tile, run)
        if run > 0:
            for i in range(rows):
                former = window_at(windows, tile, start - 1)
                fill_missing(s.left[i, start - 1], former[0], former[1], low, some, _TOP)
        for x in range(start, stop):
            for i in range(rows):
                at, cost_at = (i * width + x) * size + low, (costs + i * width + x) * size + low
                if x == 0:
                    s.least[i] = start_path(s.cost, cost_at, some, s.left, at)
                else:
                    edge = abs(np.int64(image[first + i, x]) - np.int64(image[first + i, x - 1]))
                    given = (s.left, at - size, s.least[i], s.cost, cost_at, some)
                    s.least[i] = path_step(*given, search.P1, search.P2[edge], s.left, at)
    s.right_sums[:] = NO_SUM
    diagonals, middle = len(s.down) > 1, len(s.down) // 2
    for reverse in range(windows.run_count[tile]):
        start, stop, low, some = run_of(windows, tile, windows.run_count[tile] - 1 - reverse)
        if reverse > 0:
            for i in range(rows):
                former = window_at(windows, tile, stop)
                fill_missing(s.right[i], former[0], former[1], low, some, _TOP)
        for j in range(stop - start):
            x = stop - 1 - j
            column = x - search.max_disparity + low  # right column of the first index
            begin, end = min(max(-column, 0), some), max(min(width - column, search.disparities - low, some), 0)
            for i in range(rows):
                y = first + i
                at, cost_at = (i * width + x) * size + low, (costs + i * width + x) * size + low
                path_at = i * size + low
                if x == width - 1:
                    s.least[i] = start_path(s.cost, cost_at, some, s.right, path_at)
                else:
                    edge = abs(np.int64(image[y, x]) - np.int64(image[y, x + 1]))
                    given = (s.right, path_at, s.least[i], s.cost, cost_at, some)
                    s.least[i] = path_step(*given, search.P1, search.P2[edge], s.right, path_at)
                if diagonals:
                    add_diagonals(s.down, y - top, s.up, y & _UP_MASK, x, s.totals[i])
                down_at = middle * s.down[0].size + cost_at
                up_at = (((middle if ups else 0) * _UP_ROWS + (y & _UP_MASK)) * width + x) * size + low
                ways = (s.left, at, s.right, path_at, s.down, down_at, s.up, up_at)
                s.least_totals[i] = add_paths(*ways, some, begin, end, diagonals, s.totals[i])
            for i in range(rows):  # a loop of its own: what one row waits for, the others do meanwhile
                if search.indices_only:
                    output.indices[first + i, x] = low + first_of(s.totals[i], some, s.least_totals[i])
                else:
                    if not search.own_right:
                        lower_right(s.totals[i], low, some, x, s.right_sums[i], s.right_indices[i])
                    take_winner(s.totals[i], low, some, s.least_totals[i], x, s.winners[i])
                    if search.edge_aware:
                        s.sums_of_costs[i, x] = total_cost(s.cost, (costs + i * width + x) * size + low, some)
    if not search.indices_only:
        for y in range(first, last):
            winners = s.winners[y - first]
            _finish_row(winners, y, search, output)
            if search.edge_aware and search.uniqueness > 0:
                sums = s.sums_of_costs[y - first]
                row = output.margin[y], output.reasons[y]
                _reject_alike(s.cost[y - top], winners[0], sums, windows, tile, search, *row)
            if search.own_right:
                for x in range(width):
                    output.indices[y, x] = winners[0, x]
            else:
                agree_row(winners[0], s.right_indices[y - first], search.tolerance, output.reasons[y])


@compiled(allocates=False)
def _shift(n: int, directions: int) -> int:
    """Columns by which paths of direction n shift per row: 0, and for eight paths also the diagonals."""
    return (n + 1) % 3 - 1 if directions == 3 else 0


@compiled(allocates=False)
def _step_rows(
    y: int,
    before: int,
    image: U8,
    cost: U8,
    windows: Windows,
    search: Search,
    paths: U8,
    at: int,
    at_before: int,
    least: U8,
) -> None:
    """Vertical and diagonal paths of row y, after those of the row ``before``; they start if that is y itself.

    Rows are at ``at`` and ``at_before`` in ``paths``.
    """
    directions = len(paths)
    for n in range(directions):
        shift = _shift(n, directions) if before != y else image.shape[1]
        rows = image[y], image[before], shift, cost, search.P1, search.P2
        tiles = windows, y // TILE_ROWS, before // TILE_ROWS
        step_row(*rows, paths[n, at_before], least[n, before & 1], paths[n, at], least[n, y & 1], *tiles)


@compiled(allocates=False, inlined=False)
def _match_strip(
    a: int,
    b: int,
    image: U8,
    view: View,
    given_costs: U8,
    prior: PriorCosts,
    search: Search,
    scratch: Scratch,
    output: Output,
) -> None:
    """Disparities of rows a to b, last exclusive, from a multiple of ``_ROWS`` on.

    Without paths from below, a few rows are in memory at a time.
    """
    s = scratch
    upward = len(s.up) > 0
    top, bottom = max(a - search.approach_rows, 0), min(b + search.approach_rows, len(image)) if upward else b
    done = first_needed(top, search.edge_aware) - 1
    at_before = 0
    for first in range(top, bottom, _ROWS):
        base = top if upward else first  # the row at 0 in the buffers
        last = min(first + _ROWS, bottom)
        given = (search.max_disparity, search.disparities, search.edge_aware, view, s.costs)
        if len(given_costs):
            copy_costs(given_costs, first, last, s.cost[first - base :])
        else:
            done = cost_rows(first, first == top, done, *given, s.cost[first - base :])
        for y in range(first, last):
            add_prior_costs(prior, y, search.max_disparity, search.disparities, s.cost[y - base])
        for y in range(first, min(last, b)):
            at = y - base
            _step_rows(y, max(y - 1, top), image, s.cost[at], view.windows, search, s.down, at, at_before, s.least_down)
            at_before = at
        if first >= a and not upward:
            _winners_rows(first, last, base, image, view.windows, search, s, output)
    ready = b
    for y in range(bottom - 1, a - 1 if upward else bottom, -1):
        before = min(y + 1, bottom - 1)
        at, at_before = y & _UP_MASK, before & _UP_MASK
        _step_rows(y, before, image, s.cost[y - top], view.windows, search, s.up, at, at_before, s.least_up)
        if y == a or y == ready - _ROWS:
            _winners_rows(y, ready, top, image, view.windows, search, s, output)
            ready = y


_SEARCH = numba.types.NamedTuple(
    [int64, int64, float64, int64, uint8, uint8[::1], int64, boolean, boolean, boolean], Search
)
_SCRATCH = numba.types.NamedTuple(
    [
        COSTS,
        *(uint8[:, :, ::1], uint8[:, :, :, ::1], uint8[:, :, :, ::1]),
        *(uint8[:, :, ::1], uint8[:, ::1], uint8[::1], uint8[:, :, ::1], uint8[:, :, ::1]),
        *(uint16[:, :, ::1], uint16[::1], uint32[:, ::1], uint16[:, :, ::1], uint16[:, :, ::1], uint16[:, :, ::1]),
    ],
    Scratch,
)
_OUTPUT = numba.types.NamedTuple(
    [float32[:, ::1], int16[:, ::1], uint8[:, ::1], float32[:, ::1], uint16[:, ::1]], Output
)


@compiled(
    numba.void(int64, int64, int64, READ_ONLY_U8, VIEW, uint8[:, :, ::1], PRIOR_COSTS, _SEARCH, _SCRATCH, _OUTPUT),
    allocates=False,
)
def match_strips(
    first: int,
    last: int,
    strips: int,
    image: U8,
    view: View,
    given_costs: U8,
    prior: PriorCosts,
    search: Search,
    scratch: Scratch,
    output: Output,
) -> None:
    """Match strips first to last, last exclusive, of all strips of the image.

    The costs are those of the census, unless ``given_costs``, uint8 (H, W, K), has rows.
    """
    height = len(image)
    for strip in range(first, last):
        a = height * strip // strips // _ROWS * _ROWS
        b = height * (strip + 1) // strips // _ROWS * _ROWS if strip + 1 < strips else height
        if a < b:
            _match_strip(a, b, image, view, given_costs, prior, search, scratch, output)

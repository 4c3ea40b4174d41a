# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching of strips of rows: costs, paths, sums and winners, in cache-sized buffers."""

from __future__ import annotations

from mmap import PAGESIZE
from typing import NamedTuple

import numba
import numpy as np
from numba import float32, float64, int16, int64, uint8, uint16

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.page_memory import on_pages
from stereo_depth_ros.core.types import F32, U8, U16, Reason
from stereo_depth_ros.matching.costs.census import cost_rows, padded_count
from stereo_depth_ros.matching.costs.features import copy_costs
from stereo_depth_ros.matching.costs.prior import PRIOR_COSTS, PriorCosts, add_prior_costs
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.sgm.path_costs import path_step, start_path, step_row
from stereo_depth_ros.matching.sgm.winners import (
    NO_SUM,
    add_paths,
    agree_row,
    lower_right,
    subpixel,
    take_winner,
)

__all__ = ["SPECKLE_STEPS_PER_PX", "STEPS_PER_PX", "Output", "Scratch", "Search", "match_bands"]

STEPS_PER_PX = 64
SPECKLE_STEPS_PER_PX = 8  # 4096 disparities fit in 16 bits
_BORDER, _UNIQUENESS = np.uint8(Reason.BORDER), np.uint8(Reason.UNIQUENESS)
_APART = 2  # per-pixel buffers of two bands must not share a cache line (false sharing)
_ROWS = 4  # A step along a row waits for the one before it; steps in several rows do not wait for each other.
_UP_ROWS, _UP_MASK = 8, 7  # a power of two above _ROWS: the row y is at y & 7, as a division in every step takes long


class Search(NamedTuple):
    """Search range and checks.

    ``uniqueness`` is the minimum margin over the second best, ``tolerance`` that of the left-right check in px; P2 is
    indexed by the gray difference of neighbors; vertical paths start ``approach_rows`` before the strip.
    """

    max_disparity: int
    disparities: int
    uniqueness: float
    tolerance: int
    P1: np.uint8
    P2: U8
    approach_rows: int


class Scratch(NamedTuple):
    """Buffers of a strip; in the matcher with one more leading dimension, the band.

    There are 1 or 3 directions from the rows above, and as many from below; K disparities are whole vectors.
    """

    raw: U8  # (W + 2, K) see cost_rows
    sums: U16  # (K,) see cost_rows
    smooth: U8  # (3, W, K)
    cost: U8  # (rows, W, K) matching costs
    down: U8  # (directions, rows, W, K) path costs from above
    up: U8  # (directions, _UP_ROWS, W, K) path costs from below, of the latest rows
    left: U8  # (_ROWS, W, K) path costs from the left
    right: U8  # (_ROWS, K) path costs from the right, of the latest pixels
    least: U8  # (_ROWS,) minimum path cost of the latest pixels along each row
    least_down: U8  # (directions, 2, W) minimum path cost of each pixel, of two alternating rows
    least_up: U8
    totals: U16  # (2, K / 2) see winners.py
    right_sums: U16  # (_ROWS, 2, (W + K) / 2 + 1) see lower_right
    right_indices: U16
    winners: U16  # (_ROWS, 5, W) see take_winner

    @classmethod
    def allocate(cls, bands: int, rows: int, width: int, config: MatchingConfig) -> Scratch:
        """Buffers of all bands, for strips of up to ``rows`` rows, warm-up included, and ``width`` columns."""
        count = padded_count(config.num_disparities)
        directions = 1 if config.sgm_paths == 4 else 3
        return cls(
            raw=on_pages((bands, width + 2, count), np.uint8),
            sums=on_pages((_APART * bands, count), np.uint16),
            smooth=on_pages((bands, 3, width, count), np.uint8),
            cost=on_pages((bands, rows, width, count), np.uint8),
            down=on_pages((bands, directions, rows, width, count), np.uint8),
            up=on_pages((bands, directions, _UP_ROWS, width, count), np.uint8),
            left=on_pages((bands, _ROWS, width, count), np.uint8),
            right=on_pages((_APART * bands, _ROWS, count), np.uint8),
            least=on_pages((bands, PAGESIZE), np.uint8),
            least_down=on_pages((bands, directions, 2, width), np.uint8),
            least_up=on_pages((bands, directions, 2, width), np.uint8),
            totals=on_pages((_APART * bands, 2, count // 2), np.uint16),
            right_sums=on_pages((bands, _ROWS, 2, (width + count) // 2 + 1), np.uint16),
            right_indices=on_pages((bands, _ROWS, 2, (width + count) // 2 + 1), np.uint16),
            winners=on_pages((bands, _ROWS, 5, width), np.uint16),
        )


class Output(NamedTuple):
    """Disparities (px, unfiltered), the same in coarse steps for the speckle filter, reasons and margin, (H, W)."""

    disparity_px: F32
    coarse: I16
    reasons: U8
    margin: F32


@compiled(allocates=False)
def _step_along(image: U8, x: int, x_before: int, cost: U8, search: Search, before: U8, after: U8, least: U8) -> None:
    """A step along a row, from column ``x_before`` to x; the path starts if that is outside the row."""
    if x_before < 0 or x_before >= image.size:
        least[0] = start_path(cost, after)
    else:
        edge = abs(np.int64(image[x]) - np.int64(image[x_before]))
        least[0] = path_step(before, least[0], cost, search.P1, search.P2[edge], after)


@compiled(allocates=False)
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
    for x in range(disparity_px.size):  # two loops, as the compiler has no vectors for one of so many rows
        lower = before[x] if best[x] > 0 else NO_SUM
        higher = after[x] if best[x] < last else NO_SUM
        index = np.rint((best[x] + subpixel(lower, least[x], higher)) * STEPS_PER_PX) * (1 / STEPS_PER_PX)
        disparity_px[x] = highest - index
        coarse[x] = np.int16((last - index) * SPECKLE_STEPS_PER_PX)
    for x in range(disparity_px.size):
        first = np.float32(least[x])
        second = first if rivals[x] == NO_SUM else np.float32(rivals[x])  # without a second candidate the margin is 0
        margin = np.divide(second - first, max(second, np.float32(1)))
        margins[x] = margin
        unsure = _UNIQUENESS if margin < search.uniqueness else np.uint8(0)
        reasons[x] = _BORDER if least[x] == NO_SUM else unsure


@compiled(allocates=False)
def _winners_rows(first: int, last: int, top: int, image: U8, search: Search, scratch: Scratch, output: Output) -> None:
    """Paths along rows first to last, at most ``_ROWS``, last exclusive, and the winners of all sums.

    Row y is at y - top in the buffers of costs and of paths from above.
    """
    s = scratch
    width = image.shape[1]
    for x in range(width):
        for y in range(first, last):
            i = y - first
            before = s.left[i, max(x - 1, 0)]
            _step_along(image[y], x, x - 1, s.cost[y - top, x], search, before, s.left[i, x], s.least[i : i + 1])
    s.right_sums[:] = NO_SUM
    for j in range(width):
        x = width - 1 - j
        at = x - search.max_disparity  # right column of index 0
        begin, end = max(-at, 0), min(width - at, search.disparities)
        for y in range(first, last):
            i = y - first
            path = s.right[i]
            _step_along(image[y], x, x + 1, s.cost[y - top, x], search, path, path, s.least[i : i + 1])
            ways = (s.left[i, x], path, s.down, y - top, s.up, y & _UP_MASK)
            least = add_paths(*ways, x, begin, end, s.totals)
            lower_right(s.totals, x, s.right_sums[i], s.right_indices[i])
            take_winner(s.totals, least, x, s.winners[i])
    for y in range(first, last):
        winners = s.winners[y - first]
        _finish_row(winners, y, search, output)
        agree_row(winners[0], s.right_indices[y - first], search.tolerance, output.reasons[y])


@compiled(allocates=False)
def _shift(n: int, directions: int) -> int:
    """Columns by which paths of direction n shift per row: 0, and for eight paths also the diagonals."""
    return (n + 1) % 3 - 1 if directions == 3 else 0


@compiled(allocates=False)
def _match_strip(
    a: int,
    b: int,
    image: U8,
    census: U8,
    costs: U8,
    prior: PriorCosts,
    search: Search,
    scratch: Scratch,
    output: Output,
) -> None:
    """Disparities of rows a to b, last exclusive."""
    s = scratch
    height, width = image.shape
    top, bottom = max(a - search.approach_rows, 0), min(b + search.approach_rows, height)
    directions = len(s.down)
    if len(costs):
        copy_costs(costs, top, bottom, s.cost)
    else:
        cost_rows(census, top, bottom, search.max_disparity, search.disparities, s.raw, s.sums, s.smooth, s.cost)
    for y in range(top, bottom):
        add_prior_costs(prior, y, search.max_disparity, search.disparities, s.cost[y - top])
    for y in range(top, b):
        i, before = y - top, max(y - 1 - top, 0)
        for n in range(directions):
            shift = _shift(n, directions) if y > top else width  # all paths start in the first row
            old, new = s.least_down[n, 1 - i % 2], s.least_down[n, i % 2]
            rows = image[y], image[top + before]
            step_row(*rows, shift, s.cost[i], search.P1, search.P2, s.down[n, before], old, s.down[n, i], new)
    ready = b
    for j in range(bottom - a):
        y = bottom - 1 - j
        before = min(y + 1, bottom - 1)
        for n in range(directions):
            shift = _shift(n, directions) if j > 0 else width
            old, new = s.least_up[n, 1 - y % 2], s.least_up[n, y % 2]
            rows = image[y], image[before]
            paths = s.up[n, before & _UP_MASK], old, s.up[n, y & _UP_MASK], new
            step_row(*rows, shift, s.cost[y - top], search.P1, search.P2, *paths)
        if y == a or y == ready - _ROWS:
            _winners_rows(y, ready, top, image, search, s, output)
            ready = y


_SEARCH = numba.types.NamedTuple([int64, int64, float64, int64, uint8, uint8[::1], int64], Search)
_SCRATCH = numba.types.NamedTuple(
    [
        *(uint8[:, :, ::1], uint16[:, ::1], uint8[:, :, :, ::1], uint8[:, :, :, ::1]),
        *(uint8[:, :, :, :, ::1], uint8[:, :, :, :, ::1]),
        *(uint8[:, :, :, ::1], uint8[:, :, ::1], uint8[:, ::1]),
        *(uint8[:, :, :, ::1], uint8[:, :, :, ::1]),
        *(uint16[:, :, ::1], uint16[:, :, :, ::1], uint16[:, :, :, ::1], uint16[:, :, :, ::1]),
    ],
    Scratch,
)
_OUTPUT = numba.types.NamedTuple([float32[:, ::1], int16[:, ::1], uint8[:, ::1], float32[:, ::1]], Output)


@compiled(
    numba.void(
        int64,
        int64,
        int64,
        int64,
        READ_ONLY_U8,
        uint8[:, :, :, :, ::1],
        uint8[:, :, ::1],
        PRIOR_COSTS,
        _SEARCH,
        _SCRATCH,
        _OUTPUT,
    ),
    allocates=False,
)
def match_bands(
    first: int,
    last: int,
    bands: int,
    strips: int,
    image: U8,
    census: U8,
    costs: U8,
    prior: PriorCosts,
    search: Search,
    scratch: Scratch,
    output: Output,
) -> None:
    """Match the strips of each band, with the scratch buffers of the band.

    The costs are those of the census, unless ``costs``, uint8 (H, W, K), has rows.
    """
    height = len(image)
    for band in range(first, last):
        own = Scratch(
            scratch.raw[band],
            scratch.sums[_APART * band],
            scratch.smooth[band],
            scratch.cost[band],
            scratch.down[band],
            scratch.up[band],
            scratch.left[band],
            scratch.right[_APART * band],
            scratch.least[band],
            scratch.least_down[band],
            scratch.least_up[band],
            scratch.totals[_APART * band],
            scratch.right_sums[band],
            scratch.right_indices[band],
            scratch.winners[band],
        )
        for strip in range(band * strips // bands, (band + 1) * strips // bands):
            a, b = height * strip // strips, height * (strip + 1) // strips
            _match_strip(a, b, image, census, costs, prior, search, own, output)

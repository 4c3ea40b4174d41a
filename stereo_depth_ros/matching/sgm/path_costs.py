# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global path costs in 8 bits: a step along a path, and the steps from one row to the next.

L(p, d) = C(p, d) + min(L(p-r, d), L(p-r, d +- 1) + P1, min_k L(p-r, k) + P2) - min_k L(p-r, k)
(Hirschmueller, "Stereo processing by semiglobal matching and mutual information", PAMI 2008, equation 13).

L <= max C + P2, so with max C + P1 + P2 <= 255 all intermediate values fit in 8 bits, which doubles the number
per vector register compared to 16 bits. A pixel has K path costs, whole vectors; those that only fill a vector have
the cost 255, which stays 255.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.core.vectors import (
    BYTES,
    add_saturated,
    least_lane,
    load,
    minimum,
    next_lanes,
    previous_lanes,
    repeat,
    store,
    subtract,
)
from stereo_depth_ros.matching.costs.windows import Windows, fill_missing, run_of, window_at

__all__ = ["LARGEST_PATH_COST", "path_step", "start_path", "step_row"]

LARGEST_PATH_COST = 255
_TOP = np.uint8(LARGEST_PATH_COST)


@compiled(allocates=False)
def _step(below: Any, here: Any, above: Any, least: Any, P1: Any, P2: Any, cost: Any) -> Any:
    """A step of a vector of path costs, between the vectors of the disparities before and behind it."""
    near = add_saturated(minimum(previous_lanes(here, below), next_lanes(here, above)), P1)
    return add_saturated(minimum(subtract(minimum(here, near), least), P2), cost)


@compiled(allocates=False)
def path_step(
    before: U8,
    before_at: int,
    least: np.uint8,
    cost: U8,
    cost_at: int,
    size: int,
    P1: np.uint8,
    P2: np.uint8,
    after: U8,
    after_at: int,
) -> np.uint8:
    """One step of all disparities of a pixel; returns the minimum of the new path costs.

    The K costs of a pixel are in a contiguous array from an element on, which is counted over all dimensions: that
    takes fewer instructions than views, which matters where K is one vector.

    Args:
        before, before_at: uint8, path costs of the previous pixel.
        least: their minimum.
        cost, cost_at: uint8, matching costs of this pixel.
        size: K, whole vectors.
        P1, P2: the penalties.
        after, after_at: uint8, receives the path costs of this pixel; may be those before.
    """
    none = repeat(_TOP)
    least_before, step, jump = repeat(least), repeat(P1), repeat(P2)
    last = size - BYTES
    best, below, here = none, none, load(before, before_at)
    for k in range(0, last, BYTES):
        above = load(before, before_at + k + BYTES)
        total = _step(below, here, above, least_before, step, jump, load(cost, cost_at + k))
        store(after, after_at + k, total)
        best = minimum(best, total)
        below = here
        here = above
    total = _step(below, here, none, least_before, step, jump, load(cost, cost_at + last))
    store(after, after_at + last, total)
    return least_lane(minimum(best, total))  # type: ignore[no-any-return]


@compiled(allocates=False)
def start_path(cost: U8, cost_at: int, size: int, after: U8, after_at: int) -> np.uint8:
    """The first pixel of a path: its matching costs; returns their minimum. Arguments as of :func:`path_step`."""
    best = repeat(_TOP)
    for k in range(0, size, BYTES):
        here = load(cost, cost_at + k)
        store(after, after_at + k, here)
        best = minimum(best, here)
    return least_lane(best)  # type: ignore[no-any-return]


@compiled(allocates=False, inlined=False)
def step_row(
    image: U8,
    image_before: U8,
    shift: int,
    cost: U8,
    P1: np.uint8,
    P2: U8,
    before: U8,
    least_before: U8,
    after: U8,
    least_after: U8,
    windows: Windows,
    tile: int,
    tile_before: int,
) -> None:
    """Advance the paths of a row to the next one, ``shift`` columns on; paths that enter the image start here.

    Args:
        image, image_before: uint8 (W,), this and the previous row of the left image.
        cost: uint8 (W, K), matching costs of this row.
        P2: uint8 (256,), the penalty by the gray difference of the two pixels.
        before, least_before: uint8 (W, K) and (W,), path costs of the previous row and their minimum per pixel.
        after, least_after: the same of this row, written.
        windows: what is searched; the whole range where there is a shift.
        tile, tile_before: the rows of windows of both rows; path costs that the previous one does not have are 255.
    """
    width, size = cost.shape
    if tile != tile_before:
        for x in range(width):
            of_before = window_at(windows, tile_before, x)
            of_this = window_at(windows, tile, x)
            fill_missing(before[x], of_before[0], of_before[1], of_this[0], of_this[1], _TOP)
    for run in range(windows.run_count[tile]):
        begin, end, low, some = run_of(windows, tile, run)
        for x in range(begin, end):
            x_before, at = x - shift, x * size + low
            if x_before < 0 or x_before >= width:
                least_after[x] = start_path(cost, at, some, after, at)
            else:
                edge = abs(np.int64(image[x]) - np.int64(image_before[x_before]))
                given = (before, x_before * size + low, least_before[x_before], cost, at, some)
                least_after[x] = path_step(*given, P1, P2[edge], after, at)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matching costs of semi-global matching, row by row: Hamming distances, smoothed along x and along y."""

from __future__ import annotations

from typing import NamedTuple

import numba
from numba import float32, uint8, uint16

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8, U16
from stereo_depth_ros.core.vectors import BYTES, add_saturated, load, mean, store
from stereo_depth_ros.matching.costs.census import CENSUS_BITS, LARGEST_CAP, hamming_row, quarter_half_quarter
from stereo_depth_ros.matching.costs.permeability import GROUP, smooth_along, smooth_down
from stereo_depth_ros.matching.costs.windows import WINDOWS, Windows

__all__ = ["COSTS", "LARGEST_SMOOTHED", "RAW_ROWS", "SLOTS", "VIEW", "Costs", "View", "cost_rows", "first_needed"]

LARGEST_SMOOTHED = 2 * (CENSUS_BITS + LARGEST_CAP // 4)  # costs are in half bits
RAW_ROWS = 2  # The smoothing along a row waits for the pixel before; that in another row does not.
SLOTS = 2 * GROUP


class View(NamedTuple):
    """What is computed of both images before the costs; the shares of permeability.py may be empty."""

    census: U8  # (pairs, 2, H, CENSUS_PLANES, W + 2 MARGIN), that of the matched image first
    along: U16  # (H, W)
    along_scales: U16  # (H, W)
    down: U16  # (H + 2 GROUP, W)
    windows: Windows  # with plain costs the whole range


VIEW = numba.types.NamedTuple([uint8[:, :, :, :, ::1], uint16[:, ::1], uint16[:, ::1], uint16[:, ::1], WINDOWS], View)


class Costs(NamedTuple):
    """Scratch buffers; K disparities are whole vectors."""

    raw: U8  # (RAW_ROWS, W + 2, K)
    sums: U16  # (K,)
    smooth: U8  # (SLOTS, W, K) rows smoothed along x, row y at y % SLOTS
    forward: U16  # (RAW_ROWS, W + 1, K), as the following ones see permeability.py
    backward: U16  # (RAW_ROWS, K)
    above: U16  # (W, K)
    below: U16  # (GROUP, BYTES)
    moved: U16  # (K,)
    weights: F32  # (2 + GROUP, W)
    scales: U16  # (GROUP, W)
    unused: U8  # (K,)


@compiled(allocates=False)
def first_needed(y: int, edge_aware: bool) -> int:
    """The first row whose costs those of row y, the first of a strip, depend on."""
    return y if edge_aware else max(y - 1, 0)


@compiled(allocates=False, inlined=False)
def cost_rows(
    first: int,
    starts: bool,
    done: int,
    max_disparity: int,
    count: int,
    edge_aware: bool,
    view: View,
    costs: Costs,
    out: U8,
) -> int:
    """Costs of ``GROUP`` rows from ``first`` on, in half bits; called for one group after the other.

    Args:
        first: a multiple of ``GROUP``; rows below the image are written too, with any costs.
        starts: whether this is the first group of a strip.
        done: the last row in ``costs.smooth``; before the first group the one before :func:`first_needed`.
        max_disparity, count: see hamming_row.
        edge_aware: smoothing that follows the image, see permeability.py, of costs with gray differences where texture
            is weak; otherwise (1 2 1) / 4 along x and y.
        out: uint8 (GROUP, W, K), written, at most ``LARGEST_SMOOTHED``; 255 from ``count`` on.

    Returns:
        The last row in ``costs.smooth``.
    """
    c = costs
    height = view.census.shape[2]
    while done < min(first + (2 * GROUP - 1 if edge_aware else GROUP), height - 1):
        begin, end = done + 1, min(done + 1 + RAW_ROWS, height)
        for near in range(begin, end):
            hamming_row(view.census, near, max_disparity, count, edge_aware, view.windows, c.raw[near - begin], c.sums)
        if edge_aware:
            given = (view.along, view.along_scales, c.raw, c.forward, c.backward, c.moved, c.smooth)
            smooth_along(begin, end, view.windows, *given)
        else:
            for near in range(begin, end):
                _smooth_plainly(c.raw[near - begin], c.smooth[near % SLOTS])
        done = end - 1
    if edge_aware:
        sums = (c.unused, c.weights, c.scales, c.above, c.below, c.moved, c.smooth)
        smooth_down(first, starts, view.windows, view.down, *sums, out)
    else:
        for y in range(first, min(first + GROUP, height)):
            before, here = c.smooth[max(y - 1, 0) % SLOTS], c.smooth[y % SLOTS]
            after, row = c.smooth[min(y + 1, height - 1) % SLOTS], out[y - first]
            quarter_half_quarter(before, here, after, row)
    return done


@compiled(allocates=False)
def _smooth_plainly(raw: U8, out: U8) -> None:
    """(1 2 1) / 4 along x, in half bits."""
    size = out.shape[1]
    for at in range(0, out.size, BYTES):  # over all pixels and disparities
        store(out, at, add_saturated(mean(load(raw, at), load(raw, at + 2 * size)), load(raw, at + size)))


COSTS = numba.types.NamedTuple(
    [
        *(uint8[:, :, ::1], uint16[::1], uint8[:, :, ::1], uint16[:, :, ::1], uint16[:, ::1], uint16[:, ::1]),
        *(uint16[:, ::1], uint16[::1], float32[:, ::1], uint16[:, ::1], uint8[::1]),
    ],
    Costs,
)

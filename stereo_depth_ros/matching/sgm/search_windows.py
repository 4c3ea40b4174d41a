# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Windows of the search range around disparities that are roughly known: of a small pair, or of the pair before."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import float32, int64, uint16

from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import F32, U8, U16
from stereo_depth_ros.core.vectors import BYTES
from stereo_depth_ros.matching.costs.windows import TILE_ROWS, Windows, whole_range, windows_of

__all__ = ["TILE_COLUMNS", "changed_tiles", "searched_share", "windows_around"]

TILE_COLUMNS = 32
KNOWN_SHARE = 0.5  # of the pixels around a tile: with fewer the whole range is searched
NEARER_SHARE = 0.6  # of what a window is wider than needed: thin objects that are not known are in front of others
CHANGED_LEVELS = 20  # mean gray difference of a tile to the pair before


def windows_around(
    disparity_px: F32, scale: int, shape: tuple[int, int], max_disparity: int, count: int, margin_px: int, reach_px: int
) -> Windows:
    """Windows for the tiles of an image, of 16 rows and 32 columns.

    A window has all disparities that are known within ``reach_px`` of its tile, and ``margin_px`` on both sides. Where
    half of the pixels there are not known, it is the whole range. It stays as it is from one tile to the next if it has
    what that one needs.

    Args:
        disparity_px: float32 (h, w), x_left - x_right in pixels of an image that is ``scale`` times smaller, NaN where
            it is not known.
        shape: height and width of the image that is matched.
        max_disparity, count: the range, see :func:`~stereo_depth_ros.matching.costs.census.hamming_row`.
    """
    height, width = shape
    size = -(-count // BYTES) * BYTES
    whole = whole_range(height, width, size)
    if size == BYTES:
        return whole
    _choose(disparity_px, scale, height, max_disparity, count, margin_px, reach_px, *whole[:2])
    return windows_of(*whole[:2])


def searched_share(windows: Windows, count: int) -> float:
    """The share of the range that is searched, 0..1; indices that only fill a vector do not count."""
    ends = np.minimum(windows.first.astype(np.int64) + windows.size, count)
    return float(np.mean(ends - windows.first)) / count


def changed_tiles(image: U8, before: U8, windows: Windows, whole: Windows) -> Windows:
    """The windows, but the whole range where the gray levels of a tile have changed by 20 or more on average.

    Args:
        image, before: uint8 (H, W).
        windows, whole: of the same range.
    """
    difference = np.zeros((len(windows.first), -(-image.shape[1] // TILE_COLUMNS)), np.float32)
    _differences(image, before, difference)
    changed = np.repeat(difference >= CHANGED_LEVELS, TILE_COLUMNS, axis=1)[:, : image.shape[1]]
    if not changed.any():
        return windows
    return windows_of(np.where(changed, whole.first, windows.first), np.where(changed, whole.size, windows.size))


@compiled(
    numba.void(float32[:, ::1], int64, int64, int64, int64, int64, int64, uint16[:, ::1], uint16[:, ::1]),
    allocates=False,
)
def _choose(
    disparity_px: F32,
    scale: int,
    height: int,
    max_disparity: int,
    count: int,
    margin_px: int,
    reach_px: int,
    firsts: U16,
    sizes: U16,
) -> None:
    """``sizes`` has the size of the whole range before."""
    rows, width = firsts.shape
    size: Any = np.int64(sizes[0, 0])
    for tile in range(rows):
        top = max(tile * TILE_ROWS - reach_px, 0) // scale
        bottom = min(min((tile + 1) * TILE_ROWS + reach_px, height) // scale + 1, disparity_px.shape[0])
        first: Any = np.int64(0)
        some: Any = size
        for left in range(0, width, TILE_COLUMNS):
            start = max(left - reach_px, 0) // scale
            stop = min(min(left + TILE_COLUMNS + reach_px, width) // scale + 1, disparity_px.shape[1])
            step = max(2 // scale, 1)
            lowest, highest = np.float32(np.inf), np.float32(-np.inf)
            known, seen = 0, 0
            for v in range(top, bottom, step):
                for u in range(start, stop, step):
                    d = disparity_px[v, u]
                    seen += 1
                    if not np.isnan(d):
                        known += 1
                        lowest, highest = min(lowest, d), max(highest, d)
            needed, end = 0, count
            if known > KNOWN_SHARE * seen:
                needed = min(max(max_disparity - int(np.ceil(highest * scale)) - margin_px, 0), count - 1)
                end = min(max(max_disparity - int(np.floor(lowest * scale)) + margin_px + 1, needed + 1), count)
            width_needed = min((end - needed + BYTES - 1) // BYTES * BYTES, size)
            if width_needed != some or needed < first or end > first + some:
                above = max(tile - 1, 0)
                first, some = np.int64(firsts[above, left]), np.int64(sizes[above, left])
                if tile == 0 or width_needed != some or needed < first or end > first + some:
                    some = width_needed
                    spare = int(NEARER_SHARE * (some - (end - needed)))
                    first = min(max(needed - spare, 0), size - some) // 2 * 2
                    if first + some < end:
                        first, some = 0, size
            for x in range(left, min(left + TILE_COLUMNS, width)):
                firsts[tile, x] = first
                sizes[tile, x] = some


@compiled(numba.void(READ_ONLY_U8, READ_ONLY_U8, float32[:, ::1]), allocates=False)
def _differences(image: U8, before: U8, difference: F32) -> None:
    height, width = image.shape
    for tile in range(difference.shape[0]):
        bottom = min((tile + 1) * TILE_ROWS, height)
        for column in range(difference.shape[1]):
            stop = min((column + 1) * TILE_COLUMNS, width)
            total, number = np.int64(0), 0
            for y in range(tile * TILE_ROWS, bottom, 2):
                for x in range(column * TILE_COLUMNS, stop, 2):
                    total += abs(np.int64(image[y, x]) - np.int64(before[y, x]))
                    number += 1
            difference[tile, column] = np.float32(total) / np.float32(number)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Windows of the search range: which disparities of each pixel are searched."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numba
import numpy as np
import numpy.typing as npt
from numba import int32, uint16

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import U16

__all__ = ["TILE_ROWS", "WINDOWS", "Windows", "fill_missing", "run_of", "whole_range", "window_at", "windows_of"]

I32: TypeAlias = npt.NDArray[np.int32]
TILE_ROWS = 16  # rows that share their windows: a multiple of those that are smoothed at once


class Windows(NamedTuple):
    """The indices that are searched of each pixel: ``size`` of them from ``first`` on, uint16 (tile rows, W) each.

    Sizes are whole vectors, first indices are even. Neighbors with the same window are a run, so that loops along a row
    do not look at each pixel: run r of ``run_count``, int32 (tile rows,), begins in column r of ``runs`` and ends where
    the next one begins, int32 (tile rows, W + 1).
    """

    first: U16
    size: U16
    runs: I32
    run_count: I32


WINDOWS = numba.types.NamedTuple([uint16[:, ::1], uint16[:, ::1], int32[:, ::1], int32[::1]], Windows)


def windows_of(first: U16, size: U16) -> Windows:
    """With the runs of these windows."""
    height, width = first.shape
    runs = np.zeros((height, width + 1), np.int32)
    changes = (np.diff(first, axis=1) != 0) | (np.diff(size, axis=1) != 0)
    for row, change in zip(runs, changes, strict=True):
        begins = np.flatnonzero(change) + 1
        row[1 : len(begins) + 1] = begins
        row[len(begins) + 1] = width
    return Windows(first, size, runs, (1 + np.count_nonzero(changes, axis=1)).astype(np.int32))


def whole_range(height: int, width: int, size: int) -> Windows:
    """The windows of a search of all disparities, ``size`` with those that only fill a vector."""
    shape = -(-height // TILE_ROWS), width
    return windows_of(np.zeros(shape, np.uint16), np.full(shape, size, np.uint16))


@compiled(allocates=False)
def run_of(windows: Windows, tile: int, run: int) -> Any:
    """Four numbers: the columns of a run, end exclusive, the first index of its window and the number of indices."""
    begin, end = np.int64(windows.runs[tile, run]), np.int64(windows.runs[tile, run + 1])
    return begin, end, np.int64(windows.first[tile, begin]), np.int64(windows.size[tile, begin])


@compiled(allocates=False)
def window_at(windows: Windows, tile: int, x: int) -> Any:
    """Two numbers: the first index of the window of column x, and how many it has."""
    return np.int64(windows.first[tile, x]), np.int64(windows.size[tile, x])


@compiled(allocates=False, inlined=False)
def fill_missing(values: Any, first_before: int, size_before: int, first: int, size: int, fill: Any) -> None:
    """Fill what a window has and the one before did not have, of the values of a pixel, (K,)."""
    for k in range(first, min(first + size, first_before)):
        values[k] = fill
    for k in range(max(first, first_before + size_before), first + size):
        values[k] = fill

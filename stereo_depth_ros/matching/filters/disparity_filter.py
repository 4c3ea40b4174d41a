# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mean and median filters of disparity maps that leave holes unchanged."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32

__all__ = ["DisparityFilter"]

MEAN_RADIUS = 2
TOLERANCE_PX = np.float32(1)


class DisparityFilter:
    """The filter that ``disparity_filter`` names.

    mean: over the disparities of 5 x 5 pixels that differ by at most 1 px from the center. It reduces noise and pixel
    locking, and preserves steps of more than 1 px.

    median: over the valid disparities of 3 x 3 pixels, the lower one of an even number.

    Args:
        kind: "mean", "median" or "none".
        step_px: resolution to which a mean is rounded.
    """

    def __init__(self, kind: str, step_px: float) -> None:
        self._kind = kind
        self._steps_per_px = np.float32(1 / step_px)
        self._before: F32 = np.empty((0, 0), np.float32)

    def __call__(self, disparity_px: F32) -> None:
        """Filter float32 (H, W), NaN where invalid, in place; NaN stays NaN and is ignored."""
        if self._kind == "none":
            return
        if self._before.shape != disparity_px.shape:
            self._before = np.empty_like(disparity_px)
            self._counts = np.empty_like(disparity_px)
        self._before[:] = disparity_px
        if self._kind == "median":
            run_bands(_median_rows, len(disparity_px), self._before, disparity_px)
        else:
            given = (self._before, self._counts, self._steps_per_px)
            run_bands(_mean_rows, len(disparity_px), *given, disparity_px)


@compiled(allocates=False)
def _add_row(own: F32, other: F32, counts: F32, sums: F32) -> None:
    """Add the disparities of ``other`` that agree with those of ``own``, and count them."""
    for x in range(own.size):
        agrees = np.float32(abs(own[x] - other[x]) <= TOLERANCE_PX)
        counts[x] += agrees
    for x in range(own.size):
        difference = other[x] - own[x]
        sums[x] += difference if abs(difference) <= TOLERANCE_PX else np.float32(0)


@compiled("void(int64, int64, float32[:, ::1], float32[:, ::1], float32, float32[:, ::1])", allocates=False)
def _mean_rows(first: int, last: int, before: F32, counts: F32, steps_per_px: np.float32, after: F32) -> None:
    height, width = before.shape
    for y in range(first, last):
        row, count, total = before[y], counts[y], after[y]
        count[:] = 0
        total[:] = 0  # differences from the center, to keep the precision
        for j in range(max(y - MEAN_RADIUS, 0), min(y + MEAN_RADIUS + 1, height)):
            for i in range(-MEAN_RADIUS, MEAN_RADIUS + 1):
                begin, end = max(0, -i), min(width, width - i)
                if begin < end:
                    _add_row(row[begin:end], before[j, begin + i : end + i], count[begin:end], total[begin:end])
        for x in range(width):
            mean = row[x] + total[x] / max(count[x], np.float32(1))
            total[x] = np.rint(mean * steps_per_px) / steps_per_px


@compiled("void(int64, int64, float32[:, ::1], float32[:, ::1])")
def _median_rows(first: int, last: int, before: F32, after: F32) -> None:
    height, width = before.shape
    values = np.empty(9, np.float32)
    for y in range(first, last):
        for x in range(width):
            if np.isnan(before[y, x]):
                continue
            count = 0
            for j in range(max(y - 1, 0), min(y + 2, height)):
                for i in range(max(x - 1, 0), min(x + 2, width)):
                    value = before[j, i]
                    if np.isnan(value):
                        continue
                    at = count
                    while at > 0 and values[at - 1] > value:  # insertion sort
                        values[at] = values[at - 1]
                        at -= 1
                    values[at] = value
                    count += 1
            after[y, x] = values[(count - 1) // 2]

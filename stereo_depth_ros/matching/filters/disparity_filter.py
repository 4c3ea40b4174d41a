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
_ZERO, _ONE = np.float32(0), np.float32(1)


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
        self._shape: tuple[int, ...] = (0, 0)

    def __call__(self, disparity_px: F32) -> None:
        """Filter float32 (H, W), NaN where invalid, in place; NaN stays NaN and is ignored."""
        if self._kind == "none":
            return
        if self._shape != disparity_px.shape:
            border = MEAN_RADIUS
            self._bordered = np.pad(np.full_like(disparity_px, np.nan), border, constant_values=np.nan)
            self._before = self._bordered[border:-border, border:-border]
            self._shape = disparity_px.shape
        self._before[:] = disparity_px
        if self._kind == "median":
            run_bands(_median_rows, len(disparity_px), self._bordered, disparity_px)
        else:
            run_bands(_mean_rows, len(disparity_px), self._bordered, self._steps_per_px, disparity_px)


@compiled(allocates=False)
def _add_five(row: F32, x: int, own: np.float32, total: np.float32, count: np.float32) -> tuple[np.float32, np.float32]:
    """Add the differences of five pixels from ``own`` to a total where they agree with it, and count these."""
    for i in range(2 * MEAN_RADIUS + 1):
        difference = row[x + i] - own
        agrees = abs(difference) <= TOLERANCE_PX
        total += difference if agrees else _ZERO
        count += _ONE if agrees else _ZERO
    return total, count


@compiled("void(int64, int64, float32[:, ::1], float32, float32[:, ::1])", allocates=False)
def _mean_rows(first: int, last: int, bordered: F32, steps_per_px: np.float32, after: F32) -> None:
    for y in range(first, last):
        a, b, c = bordered[y], bordered[y + 1], bordered[y + 2]
        d, e, out = bordered[y + 3], bordered[y + 4], after[y]
        for x in range(out.size):  # a loop without branches, so that it becomes one of vectors
            own = c[x + MEAN_RADIUS]
            total, count = _ZERO, _ZERO  # differences from the center, to keep the precision
            total, count = _add_five(a, x, own, total, count)
            total, count = _add_five(b, x, own, total, count)
            total, count = _add_five(c, x, own, total, count)
            total, count = _add_five(d, x, own, total, count)
            total, count = _add_five(e, x, own, total, count)
            mean = own + np.divide(total, max(count, _ONE))
            out[x] = np.rint(mean * steps_per_px) / steps_per_px


@compiled("void(int64, int64, float32[:, ::1], float32[:, ::1])")
def _median_rows(first: int, last: int, bordered: F32, after: F32) -> None:
    values = np.empty(9, np.float32)
    for y in range(first, last):
        for x in range(after.shape[1]):
            top, start = y + MEAN_RADIUS - 1, x + MEAN_RADIUS - 1  # of 3 x 3 pixels
            if np.isnan(bordered[top + 1, start + 1]):
                continue
            count = 0
            for j in range(top, top + 3):
                for i in range(start, start + 3):
                    value = bordered[j, i]
                    if np.isnan(value):
                        continue
                    at = count
                    while at > 0 and values[at - 1] > value:  # insertion sort
                        values[at] = values[at - 1]
                        at -= 1
                    values[at] = value
                    count += 1
            after[y, x] = values[(count - 1) // 2]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Median of disparities over 3 x 3 pixels, which leaves holes as they are."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.parallel import compiled, run_bands
from stereo_depth_ros.types import F32

__all__ = ["MedianFilter"]


class MedianFilter:
    """Replaces a disparity by the median of the valid ones of its 3 x 3 neighbourhood, the lower of two middle ones."""

    def __init__(self) -> None:
        self._before: F32 = np.empty((0, 0), np.float32)

    def __call__(self, disparity_px: F32) -> None:
        """Filters float32 (H, W), NaN where invalid, in place; NaN stays NaN and does not count."""
        if self._before.shape != disparity_px.shape:
            self._before = np.empty_like(disparity_px)
        self._before[:] = disparity_px
        run_bands(_median_rows, len(disparity_px), self._before, disparity_px)


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

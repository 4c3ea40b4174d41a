# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hole filling with the disparity of the background."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8

__all__ = ["fill_holes"]


def fill_holes(disparity_px: F32, reasons: U8) -> None:
    """Fill every hole with the smaller of the nearest disparities to its left and right in the row, in place.

    A pixel occluded in the right image lies behind the surface that occludes it. A row without disparities is copied
    from the nearest row with any. An empty map is unchanged.

    Args:
        disparity_px: float32 (H, W), NaN where invalid.
        reasons: uint8 (H, W), becomes 0 where a hole was filled.
    """
    known = np.isfinite(disparity_px).any(axis=1)
    if not known.any():
        return
    run_bands(_fill_rows, len(disparity_px), disparity_px)
    rows = np.flatnonzero(known)
    for y in np.flatnonzero(~known):
        disparity_px[y] = disparity_px[rows[np.argmin(np.abs(rows - y))]]
    reasons[:] = 0


@compiled("void(int64, int64, float32[:, ::1])")
def _fill_rows(first: int, last: int, disparity_px: F32) -> None:
    width = disparity_px.shape[1]
    for y in range(first, last):
        begin = 0  # of the pixels after the last valid one
        for x in range(width + 1):
            if x < width and np.isnan(disparity_px[y, x]):
                continue
            if begin < x and (begin > 0 or x < width):
                before = disparity_px[y, begin - 1] if begin > 0 else np.float32(np.inf)
                after = disparity_px[y, x] if x < width else np.float32(np.inf)
                for hole in range(begin, x):
                    disparity_px[y, hole] = min(before, after)
            begin = x + 1

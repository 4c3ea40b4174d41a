# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Filling of short gaps within a surface, along the rows."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8

__all__ = ["fill_gaps"]

TOLERANCE_PX = np.float32(1)


def fill_gaps(disparity_px: F32, reasons: U8, margin: F32, longest_px: int, step_px: float) -> None:
    """Fill the short gaps of each row whose ends differ by at most 1 px, linearly, in place.

    Gaps at the borders of the image, which have one end, and longer ones are unchanged.

    Args:
        disparity_px: float32 (H, W), px, NaN where invalid.
        reasons: uint8 (H, W), becomes 0 where a gap was filled.
        margin: float32 (H, W), in [0, 1], becomes the lesser one of both ends where a gap was filled.
        longest_px: the longest gap that is filled; 0 fills none.
        step_px: resolution to which disparities are rounded.
    """
    if longest_px > 0:
        given = (longest_px, np.float32(1 / step_px))
        run_bands(_fill_rows, len(disparity_px), *given, disparity_px, reasons, margin)


@compiled("void(int64, int64, int64, float32, float32[:, ::1], uint8[:, ::1], float32[:, ::1])", allocates=False)
def _fill_rows(
    first: int, last: int, longest_px: int, steps_per_px: np.float32, disparity_px: F32, reasons: U8, margin: F32
) -> None:
    width = disparity_px.shape[1]
    for y in range(first, last):
        end = -1  # the last disparity before x
        for x in range(width):
            if np.isnan(disparity_px[y, x]):
                continue
            before, step = disparity_px[y, end], disparity_px[y, x] - disparity_px[y, end]
            if end >= 0 and 1 < x - end <= longest_px + 1 and abs(step) <= TOLERANCE_PX:
                for gap in range(end + 1, x):
                    d = before + step * np.float32(gap - end) / np.float32(x - end)
                    disparity_px[y, gap] = np.rint(d * steps_per_px) / steps_per_px
                    margin[y, gap] = min(margin[y, end], margin[y, x])
                    reasons[y, gap] = 0
            end = x

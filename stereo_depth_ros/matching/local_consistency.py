# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Confidence from local consistency: the share of surrounding disparities that agree with that of the pixel."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32

__all__ = ["local_consistency"]

RADIUS = 9
STRIDE = 3  # one pixel in nine is a sufficient sample of the window
TOLERANCE_PX = 1.0
SAMPLES = (2 * RADIUS // STRIDE + 1) ** 2 - 1


def local_consistency(disparity_px: F32, margin: F32 | None = None) -> F32:
    """Share of the surrounding pixels, in a grid of 7 x 7 over 19 x 19 pixels, that differ by at most 1 px.

    Wrong matches rarely agree with each other locally, so this predicts errors better than the margin of the best cost
    over the second best. Holes and pixels outside the image do not agree.

    Args:
        disparity_px: float32 (H, W), NaN where invalid.
        margin: float32 (H, W), in [0, 1], confidence from the costs of the method; multiplies the share.

    Returns:
        float32 (H, W) in [0, 1], 0 where invalid.
    """
    confidence = np.empty_like(disparity_px)
    run_bands(_consistency_rows, len(disparity_px), disparity_px, confidence)
    if margin is not None:
        confidence *= margin
    return confidence


@compiled(allocates=False)
def _count_row(here: F32, there: F32, shift: int, counts: F32) -> None:
    """Add 1 where ``there``, ``shift`` columns on, agrees with ``here``."""
    begin, end = max(0, -shift), min(here.size, here.size - shift)
    if begin < end:
        own, other, total = here[begin:end], there[begin + shift : end + shift], counts[begin:end]
        for x in range(own.size):
            total[x] += np.float32(abs(own[x] - other[x]) <= np.float32(TOLERANCE_PX))


@compiled("void(int64, int64, float32[:, ::1], float32[:, ::1])", allocates=False)
def _consistency_rows(first: int, last: int, disparity_px: F32, confidence: F32) -> None:
    height = len(disparity_px)
    for y in range(first, last):
        counts = confidence[y]
        counts[:] = 0
        for j in range(-RADIUS, RADIUS + 1, STRIDE):
            if 0 <= y + j < height:
                for i in range(-RADIUS, RADIUS + 1, STRIDE):
                    if i != 0 or j != 0:
                        _count_row(disparity_px[y], disparity_px[y + j], i, counts)
        for x in range(counts.size):
            counts[x] *= np.float32(1 / SAMPLES)

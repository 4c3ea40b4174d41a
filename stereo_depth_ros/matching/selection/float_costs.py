# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection from float costs: winner, uniqueness, left-right check, sub-pixel fit, median and speckle filters."""

from __future__ import annotations

import functools
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching.filters.speckle_filter import I16, SpeckleFilter, disparity_from_x16
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.protocol import X16_STEPS

__all__ = ["I64", "finish", "median_filter", "select_row"]

I64: TypeAlias = npt.NDArray[np.int64]

BORDER = int(Reason.BORDER)
LEFT_RIGHT = int(Reason.LEFT_RIGHT)
TEXTURE = int(Reason.TEXTURE)
UNIQUENESS = int(Reason.UNIQUENESS)


@compiled()
def select_row(
    y: int,
    costs: F32,
    max_disparity: int,
    parabola: bool,
    uniqueness: float,
    tolerance: int,
    disparity_x16: I16,
    reasons: U8,
) -> None:
    """Disparity of lowest cost of every pixel of row ``y``, or the reason against it; for kernels.

    Args:
        y: row of ``disparity_x16`` and ``reasons`` that is written.
        costs: float32 (W, D), not negative, inf where a disparity has no cost. Index k is disparity
            ``max_disparity`` - k; of equal costs the largest disparity wins.
        parabola: sub-pixel fit of a parabola (squares, correlations), else of two lines (absolute differences).
        uniqueness: percentage by which all costs but those adjacent to the winner must be above it; 0 disables it.
        tolerance: of the left-right check, px; 0 disables it.
        disparity_x16: int16 (H, W), disparity in 1/16 px where valid.
        reasons: uint8 (H, W): BORDER if no disparity is in the right image, TEXTURE if none has a cost.
    """
    width, count = costs.shape
    for x in range(width):
        best, index = np.float32(np.inf), -1
        for k in range(count):
            if costs[x, k] < best:
                best, index = costs[x, k], k
        if index < 0:
            inside = x >= max_disparity - count + 1 and x - max_disparity < width
            reasons[y, x] = TEXTURE if inside else BORDER
            continue
        second = np.float32(np.inf)
        for k in range(count):
            if costs[x, k] < second and abs(k - index) > 1:
                second = costs[x, k]
        disparity_x16[y, x] = (max_disparity - index) * X16_STEPS + _offset(costs, x, index, parabola)
        rejected = uniqueness > 0 and second <= best * (1 + uniqueness / 100)
        reasons[y, x] = UNIQUENESS if rejected else 0
    if tolerance > 0:
        _check_right(y, costs, max_disparity, tolerance, disparity_x16, reasons)


@compiled()
def _offset(costs: F32, x: int, index: int, parabola: bool) -> int:
    """Sub-pixel part in 1/16 px, -8..8, from the adjacent costs; 0 if one is missing."""
    if index == 0 or index == costs.shape[1] - 1:
        return 0
    # Disparities fall with the index.
    above, here, below = np.float64(costs[x, index - 1]), np.float64(costs[x, index]), np.float64(costs[x, index + 1])
    span = above + below - 2 * here if parabola else max(above, below) - here
    return int(np.rint((below - above) / (2 * span) * X16_STEPS)) if 0 < span < np.inf else 0


@compiled()
def _check_right(y: int, costs: F32, max_disparity: int, tolerance: int, disparity_x16: I16, reasons: U8) -> None:
    """Mark pixels whose right pixel prefers a disparity more than ``tolerance`` px away."""
    width, count = costs.shape
    preferred = np.zeros(width, np.int64)
    for at in range(width):
        best = np.float32(np.inf)
        for k in range(count):
            x = at + max_disparity - k
            if 0 <= x < width and costs[x, k] < best:
                best = costs[x, k]
                preferred[at] = max_disparity - k
    for x in range(width):
        if reasons[y, x] == 0:
            disparity = (np.int64(disparity_x16[y, x]) + X16_STEPS // 2) // X16_STEPS
            at = min(max(x - disparity, 0), width - 1)
            if abs(preferred[at] - disparity) > tolerance:
                reasons[y, x] = LEFT_RIGHT


def median_filter(disparity_x16: I16, reasons: U8, size: int) -> I16:
    """Median of the valid pixels in a square of odd side ``size`` px (the lower one of an even number).

    Args:
        disparity_x16: int16 (H, W), disparity in 1/16 px.
        reasons: uint8 (H, W), 0 where valid. Other pixels are ignored and unchanged.

    Returns:
        int16 (H, W), 1/16 px.
    """
    filtered = disparity_x16.copy()
    valid = disparity_x16[reasons == 0]
    if size > 1 and valid.size:
        low, high = int(valid.min()), int(valid.max())
        run_bands(
            _median_rows, disparity_x16.shape[0], disparity_x16, reasons, size // 2, low, high - low + 1, filtered
        )
    return filtered


@compiled("void(int64, int64, int16[:, ::1], uint8[:, ::1], int64, int64, int64, int16[:, ::1])")
def _median_rows(
    first: int, last: int, disparity_x16: I16, reasons: U8, half: int, low: int, levels: int, filtered: I16
) -> None:
    """Sliding histogram (Huang, Yang and Tang 1979): columns enter and leave, the median is updated."""
    height, width = disparity_x16.shape
    counts = np.empty(levels, np.int32)
    for y in range(first, last):
        top, bottom = max(0, y - half), min(height, y + half + 1)
        counts[:] = 0
        total, median, below = 0, 0, 0  # below: number of values below the median
        for x in range(-half, width):
            for column, step in ((x + half, 1), (x - half - 1, -1)):
                if 0 <= column < width:
                    for row in range(top, bottom):
                        if reasons[row, column] == 0:
                            level = np.int64(disparity_x16[row, column]) - low
                            counts[level] += step
                            total += step
                            below += step if level < median else 0
            if x < 0 or reasons[y, x]:
                continue
            rank = (total - 1) // 2
            while below > rank:
                median -= 1
                below -= counts[median]
            while below + counts[median] <= rank:
                below += counts[median]
                median += 1
            filtered[y, x] = median + low


def finish(
    disparity_x16: I16, reasons: U8, config: MatchingConfig, step_px: float, margin: F32 | None = None
) -> MatchResult:
    """Speckles removed (``speckle_range`` in px), disparities in px, :func:`local_consistency` as the confidence."""
    SpeckleFilter(config.speckle_size, config.speckle_range * X16_STEPS)(disparity_x16, reasons)
    disparity_px = np.empty(disparity_x16.shape, np.float32)
    disparity_from_x16(disparity_x16, reasons, disparity_px)
    if margin is not None:
        margin[reasons != 0] = 0  # including holes that will be filled
    return MatchResult(disparity_px, reasons, step_px, functools.partial(local_consistency, disparity_px, margin))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernel of one adaptive window: a rectangle that grows while the variance of its disparity decreases."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.matching.selection.float_costs import I64

__all__ = ["Maps", "distances", "grow_window", "scratch"]

Maps: TypeAlias = tuple[F32, F32, F32, F32]  # (H, W): left, right, slope of the right along the row, disparity

REACH = 10  # px a window may grow in each direction: at most 21 x 21
NOISE_POWER = np.float32(2)  # 2 sigma^2 of the gray values of one camera, sigma = 1 gray level

# Sums over the pixels of each ring around the center; after the last ring, over all of them.
RESIDUAL, GRADIENT, CROSS, POWER, SQUARE, COUNT, SPREAD = range(7)
TERMS = 7
RINGS = TOTAL = round(REACH * 2**0.5) + 1

WINDOW = 4  # sides 0..3 are up, down, left, right, followed by the window itself


def distances() -> tuple[F32, I64]:
    """1 / r (0 at the center) and r rounded, of the pixels that are up to REACH rows and columns away."""
    away = np.arange(REACH + 1)
    distance = np.hypot(away[:, None], away)
    inverse = np.divide(1, distance, out=np.zeros_like(distance), where=distance > 0)
    return inverse.astype(np.float32), np.rint(distance).astype(np.int64)


def scratch(count: int) -> tuple[F32, I64]:
    """Buffers of ``count`` windows: sums of the four sides and the window, extents and closed sides."""
    return np.zeros((count, WINDOW + 1, TERMS, RINGS + 1), np.float32), np.zeros((count, 2, 4), np.int64)


@compiled(allocates=False)
def grow_window(
    maps: Maps, center: float, y: int, x: int, inverse: F32, rings: I64, sums: F32, extent: I64, closed: I64
) -> tuple[np.float32, np.float32]:
    """Grow the window around (y, x) while the variance of the disparity ``center`` decreases.

    Args:
        inverse, rings: of :func:`distances`.
        sums, extent, closed: of :func:`scratch`.

    Returns:
        Increment of the disparity, px, and negative log-likelihood per pixel; inf if there is no window.
    """
    window = sums[WINDOW]
    sums[:] = 0
    for row in range(y - 1, y + 2):
        for column in range(x - 1, x + 2):
            if not _add_pixel(maps, center, y, x, row, column, inverse, rings, window):
                return np.float32(0), np.float32(np.inf)
    precision = _precision(window, sums[0])
    extent[:] = 1
    for side in range(4):
        closed[side] = not _add_strip(maps, center, y, x, extent, side, inverse, rings, sums[side])
    best = 0
    while best >= 0:
        best, best_precision = -1, precision
        for side in range(4):
            if not closed[side]:
                found = _precision(window, sums[side])
                closed[side] = found < precision
                if found >= best_precision:
                    best, best_precision = side, found
        if best >= 0:
            precision = best_precision
            _add_side(maps, center, y, x, extent, best, inverse, rings, sums, closed)
    sums[0] = 0
    return _estimate(window, sums[0])


@compiled(allocates=False)
def _add_side(
    maps: Maps,
    center: float,
    y: int,
    x: int,
    extent: I64,
    side: int,
    inverse: F32,
    rings: I64,
    sums: F32,
    closed: I64,
) -> None:
    """Add a side to the window, and sum the strips next to the grown window."""
    for term in range(TERMS):
        for ring in range(RINGS + 1):
            sums[WINDOW, term, ring] += sums[side, term, ring]
    extent[side] += 1
    closed[side] = not _add_strip(maps, center, y, x, extent, side, inverse, rings, sums[side])
    end = extent[side] if side % 2 else -extent[side]
    for across in range(2 - side // 2 * 2, 4 - side // 2 * 2):  # strips that became one pixel longer
        if not closed[across]:
            row, column = _beside(y, x, extent, across, end)
            closed[across] = not _add_pixel(maps, center, y, x, row, column, inverse, rings, sums[across])


@compiled(allocates=False)
def _add_strip(
    maps: Maps, center: float, y: int, x: int, extent: I64, side: int, inverse: F32, rings: I64, sums: F32
) -> bool:
    """Sum the row or column next to the window on one side; false if it is not available."""
    sums[:] = 0
    if extent[side] == REACH:
        return False
    across = 2 - side // 2 * 2  # the first of the two sides that the strip goes from and to
    for along in range(-extent[across], extent[across + 1] + 1):
        row, column = _beside(y, x, extent, side, along)
        if not _add_pixel(maps, center, y, x, row, column, inverse, rings, sums):
            return False
    return True


@compiled(allocates=False)
def _beside(y: int, x: int, extent: I64, side: int, along: int) -> tuple[int, int]:
    """Row and column next to the window on one side, ``along`` px along the side from the center."""
    outside = (extent[side] + 1) * (2 * (side % 2) - 1)
    return (y + outside, x + along) if side < 2 else (y + along, x + outside)


@compiled(allocates=False)
def _add_pixel(
    maps: Maps, center: float, y: int, x: int, row: int, column: int, inverse: F32, rings: I64, sums: F32
) -> bool:
    """Add a pixel to sums of the window around (y, x); false if it has no disparity or is outside."""
    left, right, slope, disparity = maps
    height, width = left.shape
    shift = np.int64(np.ceil(center))
    at = column - shift  # the position in the right image is between this column and the next
    if row < 0 or row >= height or column < 0 or column >= width or at < 1 or at > width - 3:
        return False
    difference = disparity[row, column] - center
    if np.isnan(difference):
        return False
    t = np.float32(shift - center)
    residual = right[row, at] + t * (right[row, at + 1] - right[row, at]) - left[row, column]
    gradient = slope[row, at] + t * (slope[row, at + 1] - slope[row, at])
    down, aside = abs(row - y), abs(column - x)
    ring = rings[down, aside]
    sums[RESIDUAL, ring] += residual
    sums[GRADIENT, ring] += gradient
    sums[CROSS, ring] += residual * gradient
    sums[POWER, ring] += gradient * gradient
    sums[SQUARE, ring] += residual * residual
    sums[COUNT, ring] += np.float32(1)
    sums[POWER, TOTAL] += gradient * gradient
    sums[COUNT, TOTAL] += np.float32(1)
    sums[SPREAD, TOTAL] += difference * difference * inverse[down, aside]
    return True


@compiled(allocates=False)
def _variance_rate(window: F32, side: F32) -> np.float32:
    """af ad of the window together with one side."""
    power, count = window[POWER, TOTAL] + side[POWER, TOTAL], window[COUNT, TOTAL] + side[COUNT, TOTAL]
    return np.float32(power / count * (window[SPREAD, TOTAL] + side[SPREAD, TOTAL]) / count)


@compiled(allocates=False)
def _precision(window: F32, side: F32) -> np.float32:
    """Inverse variance of the disparity from the window together with one side."""
    rate = _variance_rate(window, side)
    power, gradient, count = np.float32(0), np.float32(0), np.float32(0)
    for ring in range(RINGS):
        weight = 1 / (NOISE_POWER + rate * np.float32(ring))
        power += weight * (window[POWER, ring] + side[POWER, ring])
        gradient += weight * (window[GRADIENT, ring] + side[GRADIENT, ring])
        count += weight * (window[COUNT, ring] + side[COUNT, ring])
    return np.float32(power - gradient * gradient / count)


@compiled(allocates=False)
def _estimate(window: F32, nothing: F32) -> tuple[np.float32, np.float32]:
    """Increment, and mean of r^2 / s^2 + log s^2 of the pixels, r being the residual of I - J."""
    rate = _variance_rate(window, nothing)
    residual, cross, square = np.float32(0), np.float32(0), np.float32(0)
    gradient, count, logarithm = np.float32(0), np.float32(0), np.float32(0)
    for ring in range(RINGS):
        variance = NOISE_POWER + rate * np.float32(ring)
        residual += window[RESIDUAL, ring] / variance
        cross += window[CROSS, ring] / variance
        square += window[SQUARE, ring] / variance
        gradient += window[GRADIENT, ring] / variance
        count += window[COUNT, ring] / variance
        logarithm += window[COUNT, ring] * np.log(variance)
    precision = _precision(window, nothing)
    if precision <= 0:
        return np.float32(0), np.float32(np.inf)
    cross -= residual * gradient / count
    square -= residual * residual / count + cross * cross / precision
    return cross / precision, (square + logarithm) / window[COUNT, TOTAL]

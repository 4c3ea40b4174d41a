# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Windows of single pixels searched along a row of the other image: correlation over the range, and sub-pixel part."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numba
import numpy as np
import numpy.typing as npt
from numba import float64, int64

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import F64, U8

__all__ = ["Pixels", "RowMatches", "search_rows"]

I64: TypeAlias = npt.NDArray[np.int64]

HALF = 5
SIDE = 2 * HALF + 1
REACH_PX = 3.0  # standard deviation of the weight by distance
SIMILAR_GRAY = 20.0  # difference to the center at which the weight has fallen to 1 / e
LEAST_VARIANCE = 2.0  # of a window, gray levels squared; flatter windows are noise
APART_PX = 2  # disparities that are further from the best one are other places
STEPS, STOP_PX, FARTHEST_PX = 8, 0.002, 1.5  # of the sub-pixel iteration


class RowMatches(NamedTuple):
    """What a search finds for N pixels, float64 (N,) each.

    ``disparity_px`` is the refined one, NaN where the iteration fails, and ``correlation`` that at its end.
    ``expected`` is the best correlation within 1 px of the expected disparity, ``elsewhere`` that more than 2 px
    away; -1 to 1.
    """

    disparity_px: F64
    correlation: F64
    expected: F64
    elsewhere: F64


class Pixels(NamedTuple):
    """N pixels of one image and what is expected of them.

    ``x``, ``y`` and the row in the other image, int64 (N,); the expected disparity, px, and by how much it grows from
    row to row of the window, float64 (N,).
    """

    x: I64
    y: I64
    other_y: I64
    expected_px: F64
    slant: F64


def search_rows(image: U8, other: U8, pixels: Pixels, search_px: tuple[int, int], sign: int) -> RowMatches:
    """The disparity of pixels by the window around each of them, 11 x 11 px.

    Gray values of a window are weighted by their distance to the center and by their difference to its gray value
    (Yoon and Kweon 2006), so that few of another surface count. Windows are compared by weighted normalized
    cross-correlation over all disparities searched. The best one within 1 px of the expected disparity is refined by
    Gauss-Newton steps along the row (Lucas and Kanade 1981) with gain and offset of the gray values.

    Args:
        image, other: uint8 (H, W), C-contiguous.
        pixels: of ``image``.
        search_px: first and last disparity searched.
        sign: 1 from the left image to the right one, -1 from the right to the left.
    """
    count = len(pixels.x)
    found = RowMatches(*(np.full(count, np.nan) for _ in RowMatches._fields))
    if count:
        run_bands(_search, count, image, other, pixels, *search_px, sign, found, min_rows=64)
    return found


@compiled(allocates=False)
def _clip(at: int, size: int) -> int:
    return min(max(at, 0), size - 1)


@compiled(allocates=False)
def _weights(image: U8, x: int, y: int, window: F64, weights: F64) -> float:
    """The window and its weights, which sum to 1; returns its weighted variance, and removes its mean."""
    height, width = image.shape
    total = 0.0
    center = float(image[y, x])
    for j in range(SIDE):
        v = _clip(y + j - HALF, height)
        for i in range(SIDE):
            gray = float(image[v, _clip(x + i - HALF, width)])
            away = (i - HALF) ** 2 + (j - HALF) ** 2
            weight = np.exp(-away / (2 * REACH_PX * REACH_PX) - abs(gray - center) / SIMILAR_GRAY)
            window[j, i], weights[j, i] = gray, weight
            total += weight
    mean = 0.0
    for j in range(SIDE):
        for i in range(SIDE):
            weights[j, i] /= total
            mean += weights[j, i] * window[j, i]
    variance = 0.0
    for j in range(SIDE):
        for i in range(SIDE):
            window[j, i] -= mean
            variance += weights[j, i] * window[j, i] * window[j, i]
    return variance


@compiled(allocates=False)
def _correlation(other: U8, x: int, y: int, shear: float, window: F64, weights: F64, variance: float) -> float:
    """Weighted normalized cross-correlation with the window around (x, y) of the other image."""
    height, width = other.shape
    first = second = product = 0.0
    for j in range(SIDE):
        v = _clip(y + j - HALF, height)
        begin = x - HALF - int(np.rint(shear * (j - HALF)))
        for i in range(SIDE):
            gray = float(other[v, _clip(begin + i, width)])
            weighted = weights[j, i] * gray
            first += weighted
            second += weighted * gray
            product += weighted * window[j, i]
    other_variance = second - first * first
    return float(product / np.sqrt(max(other_variance, LEAST_VARIANCE) * max(variance, LEAST_VARIANCE)))


@compiled(allocates=False)
def _cubic(other: U8, y: int, at: float) -> tuple[float, float]:
    """Gray value and its derivative along the row, by the cubic of Catmull and Rom."""
    width = other.shape[1]
    base = int(np.floor(at))
    t = at - base
    a = float(other[y, _clip(base - 1, width)])
    b = float(other[y, _clip(base, width)])
    c = float(other[y, _clip(base + 1, width)])
    d = float(other[y, _clip(base + 2, width)])
    one, two, three = 0.5 * (c - a), a - 2.5 * b + 2 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)
    return b + t * (one + t * (two + t * three)), one + t * (2 * two + 3 * t * three)


@compiled(allocates=False)
def _refined(
    other: U8, x: int, y: int, start_px: float, slant: float, sign: int, window: F64, weights: F64, variance: float
) -> tuple[float, float]:
    """Disparity and correlation by Gauss-Newton steps; gain and offset of the other window are free.

    window = gain other + offset + gain shift other', least squares (Lucas and Kanade 1981) along the row.
    """
    height = other.shape[0]
    d = start_px
    correlation = 0.0
    for _ in range(STEPS):
        mean = slope_mean = 0.0
        rr = rs = ss = lr = ls = 0.0
        for j in range(SIDE):
            v = _clip(y + j - HALF, height)
            begin = x - HALF - sign * (d + slant * (j - HALF))
            for i in range(SIDE):
                gray, slope = _cubic(other, v, begin + i)
                w = weights[j, i]
                mean += w * gray
                slope_mean += w * slope
                rr += w * gray * gray
                rs += w * gray * slope
                ss += w * slope * slope
                lr += w * window[j, i] * gray
                ls += w * window[j, i] * slope
        rr -= mean * mean
        rs -= mean * slope_mean
        ss -= slope_mean * slope_mean
        correlation = lr / np.sqrt(max(rr, LEAST_VARIANCE) * max(variance, LEAST_VARIANCE))
        determinant = rr * ss - rs * rs
        if determinant <= 1e-6 * rr * ss or rr <= 0:
            return np.nan, correlation
        gain = (lr * ss - ls * rs) / determinant
        if gain <= 0.2:
            return np.nan, correlation
        step = -sign * (ls * rr - lr * rs) / determinant / gain
        step = min(max(step, -1.0), 1.0)
        d += step
        if abs(d - start_px) > FARTHEST_PX:
            return np.nan, correlation
        if abs(step) < STOP_PX:
            return d, correlation
    return d, correlation


_PIXELS = numba.types.NamedTuple([*[int64[::1]] * 3, *[float64[::1]] * 2], Pixels)
_FOUND = numba.types.NamedUniTuple(float64[::1], 4, RowMatches)


@compiled(numba.void(int64, int64, READ_ONLY_U8, READ_ONLY_U8, _PIXELS, int64, int64, int64, _FOUND))
def _search(
    first: int, last: int, image: U8, other: U8, pixels: Pixels, low: int, high: int, sign: int, found: RowMatches
) -> None:
    width = other.shape[1]
    window, weights = np.empty((SIDE, SIDE)), np.empty((SIDE, SIDE))
    for n in range(first, last):
        x, y = pixels.x[n], pixels.other_y[n]
        variance = _weights(image, x, pixels.y[n], window, weights)
        near, elsewhere, start = -1.0, -1.0, -1
        expected = pixels.expected_px[n]
        for d in range(low, high + 1):
            at = x - sign * d
            if 0 <= at < width:
                correlation = _correlation(other, at, y, sign * pixels.slant[n], window, weights, variance)
                if abs(d - expected) <= 1.0 and correlation > near:
                    near, start = correlation, d
                elif abs(d - expected) > APART_PX and correlation > elsewhere:
                    elsewhere = correlation
        found.expected[n], found.elsewhere[n] = near, elsewhere
        if near > -1.0:
            refined, correlation = _refined(other, x, y, float(start), pixels.slant[n], sign, window, weights, variance)
            found.disparity_px[n], found.correlation[n] = refined, correlation

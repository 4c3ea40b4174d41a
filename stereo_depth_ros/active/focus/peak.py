# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernel of depth from focus: the peak of the focus measure of each pixel over the images, by a Gaussian."""

from __future__ import annotations

import math

import numpy as np

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8, Reason

__all__ = ["find_peaks"]

_TEXTURE, _RANGE, _UNIQUENESS = (np.uint8(reason) for reason in (Reason.TEXTURE, Reason.RANGE, Reason.UNIQUENESS))
_MAP = "float32[:, ::1]"
_CERTAIN = np.float32(6.0)  # standard deviations that a peak stands above noise, or a second peak above its valley
_LEAST = np.float32(1e-6)  # of a measure, whose logarithm is taken
_CONTRAST = np.float32(1.15)  # of a peak to the least measure of a pixel
_SECOND = np.float32(0.3)  # height of a second peak above its valley, divided by that of the first one above the least


@compiled(f"void(int64, int64, float32[:, :, ::1], float64[::1], float32, float32, {_MAP}, {_MAP}, uint8[:, ::1])")
def find_peaks(
    first: int,
    last: int,
    measure: F32,
    positions: F64,
    noise_mean: np.float32,
    noise_sigma: np.float32,
    found: F32,
    sigma: F32,
    reasons: U8,
) -> None:
    """Fits exp(-(p - mean)^2 / (2 width^2)) to the measure at the maximum and on both sides of it.

    Nayar and Nakagawa (1994), equations 14 to 19, here for positions that need not be equally spaced.

    Args:
        first, last: rows, last exclusive.
        measure: float32 (N, H, W).
        positions: float64 (N,), strictly monotone: what blur is proportional to the difference of.
        noise_mean, noise_sigma: of the measure, by the noise of the camera.
        found, sigma: float32 (H, W), written: position of the peak and its standard deviation, NaN where invalid.
        reasons: uint8 (H, W), bits of :class:`Reason` are added.
    """
    count, _, width = measure.shape
    for y in range(first, last):
        for x in range(width):
            found[y, x] = sigma[y, x] = np.float32(np.nan)
            best, least = 0, measure[0, y, x]
            for k in range(1, count):
                value = measure[k, y, x]
                if value > measure[best, y, x]:
                    best = k
                least = min(least, value)
            top = measure[best, y, x]
            if top < noise_mean + _CERTAIN * noise_sigma or top < _CONTRAST * least + _CERTAIN * noise_sigma:
                reasons[y, x] |= _TEXTURE
                continue
            if best in (0, count - 1):
                reasons[y, x] |= _RANGE
                continue
            if _has_second(measure, y, x, best, least, noise_sigma):
                reasons[y, x] |= _UNIQUENESS
                continue
            a, b, c = positions[best - 1], positions[best], positions[best + 1]
            la, lb, lc = (
                math.log(max(measure[best - 1, y, x], _LEAST)),
                math.log(top),
                math.log(max(measure[best + 1, y, x], _LEAST)),
            )
            # ln F = parabola through three points: slopes on both sides, and their change
            left, right = (lb - la) / (b - a), (lc - lb) / (c - b)
            curvature = 2 * (right - left) / (c - a)
            if not curvature < 0:
                reasons[y, x] |= _TEXTURE
                continue
            mean = 0.5 * (a + b) - left / curvature
            # derivatives of the mean by ln F of the three images
            da = 1 / ((b - a) * curvature) + left / curvature**2 * (2 / ((c - a) * (b - a)))
            dc = left / curvature**2 * (2 / ((c - a) * (c - b)))
            db = -da - dc
            variance = (
                (da * noise_sigma / max(measure[best - 1, y, x], _LEAST)) ** 2
                + (db * noise_sigma / top) ** 2
                + (dc * noise_sigma / max(measure[best + 1, y, x], _LEAST)) ** 2
            )
            found[y, x] = np.float32(mean)
            sigma[y, x] = np.float32(math.sqrt(variance))


@compiled(allocates=False)
def _has_second(measure: F32, y: int, x: int, best: int, least: np.float32, noise_sigma: np.float32) -> bool:
    """Whether another maximum stands clearly above the valley between it and the first one."""
    needed = max(_SECOND * (measure[best, y, x] - least), _CERTAIN * noise_sigma)
    count = measure.shape[0]
    for direction in (-1, 1):
        valley = measure[best, y, x]
        k = best + direction
        while 0 <= k < count:
            value = measure[k, y, x]
            valley = min(valley, value)
            if value - valley > needed:
                return True
            k += direction
    return False

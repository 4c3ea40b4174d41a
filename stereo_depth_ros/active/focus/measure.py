# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Focus measure: the sum-modified Laplacian of an image, and what the noise of the camera contributes to it."""

from __future__ import annotations

import math

import cv2
import numpy as np

from stereo_depth_ros.core.types import F32, U8

__all__ = ["image_noise", "mean_of_noise", "sigma_of_measure", "sum_modified_laplacian"]

_CLIPPED = (2, 250)  # where noise does not show; JPEG leaves less than 255
_QUANTIZATION = 1 / math.sqrt(12)
_SIGN_AVERAGE = 12.0  # variance of ML at an edge, of noise of variance 1: 20 or 4 by the signs of the two terms


def sum_modified_laplacian(gray: U8, window: int) -> F32:
    """The mean of the modified Laplacian over a window, float32 (H, W), gray levels.

    ML(x, y) = |2 I(x, y) - I(x - 1, y) - I(x + 1, y)| + |2 I(x, y) - I(x, y - 1) - I(x, y + 1)|, summed over the window
    (Nayar and Nakagawa, "Shape from focus", 1994, equations 10 to 12), here divided by its pixels.

    Args:
        gray: uint8 (H, W).
        window: width and height, odd, px.
    """
    row = np.array([[-1, 2, -1]], np.float32)
    laplacian = cv2.filter2D(gray, cv2.CV_16S, row, borderType=cv2.BORDER_REFLECT_101)
    other = cv2.filter2D(gray, cv2.CV_16S, row.T, borderType=cv2.BORDER_REFLECT_101)
    modified = np.abs(laplacian) + np.abs(other)
    return np.asarray(cv2.boxFilter(modified, cv2.CV_32F, (window, window)), np.float32)


def image_noise(gray: U8) -> float:
    """Standard deviation of the noise of an image, gray levels (after Immerkaer, 1996, with the median).

    The second differences in x of the second differences in y leave little of an image that is out of focus.

    Args:
        gray: uint8 (H, W).
    """
    kernel = np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32)
    off = np.abs(cv2.filter2D(gray, cv2.CV_16S, kernel))[(gray > _CLIPPED[0]) & (gray < _CLIPPED[1])]
    if not off.size:
        return _QUANTIZATION
    counts = np.cumsum(np.bincount(off))
    half = off.size / 2
    level = int(np.searchsorted(counts, half))
    below = counts[level - 1] if level else 0
    median = max(level - 0.5, 0.0) + (half - below) / (counts[level] - below) * (1.0 if level else 0.5)
    return max(float(median) / 0.6745 / 6, _QUANTIZATION)


def mean_of_noise(noise: float) -> float:
    """The mean of the measure where an image shows nothing but noise: 2 sqrt(6) sqrt(2 / pi) of its sigma."""
    return 2 * math.sqrt(6) * math.sqrt(2 / math.pi) * noise


def sigma_of_measure(noise: float, window: int) -> float:
    """Standard deviation of the measure by noise of this standard deviation, where the texture is strong."""
    return math.sqrt(_SIGN_AVERAGE) * noise / window

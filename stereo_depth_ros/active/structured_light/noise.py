# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of a camera, estimated from the images of a capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.types import U8

__all__ = ["Noise"]

_LEAST_LEVELS = 0.5  # rounding to whole levels, and compression
_STEP_PX = 2  # noise of neighbors is not independent after demosaicing and compression
_MAD = 1.4826  # standard deviation of a normal variable, relative to its median absolute deviation
_SAMPLES = 200_000
_LEAST_APART = 10.0  # levels of two images of which the rise of the noise is found


@dataclass(frozen=True)
class Noise:
    """Noise that rises with the light: its variance is ``variance + per_level * level``.

    Attributes:
        variance: of the gray levels, without light.
        per_level: rise of the variance for each gray level (shot noise).
    """

    variance: float
    per_level: float = 0.0

    @staticmethod
    def of_images(images: Sequence[U8]) -> Noise:
        """The noise of images of a scene that is lit evenly, such as by white and by black.

        From the median size of the differences of second order in both directions, which edges and slopes of the scene
        change little (Immerkaer 1996, eq. 2, with the median in place of the mean), of the brighter half of each image.
        Saturated and black pixels are left out. The noise is not below that of rounding.

        Args:
            images: uint8 (H, W), one or more.
        """
        found = sorted(_level_and_variance(image) for image in images)
        (low, dark), (high, bright) = found[0], found[-1]
        rise = (bright - dark) / (high - low) if high - low >= _LEAST_APART else 0.0
        if rise <= 0:
            return Noise(max(dark, bright))
        return Noise(max(dark - rise * low, _LEAST_LEVELS**2), rise)

    def sigma(self, level: float) -> float:
        """Standard deviation at a gray level."""
        return float(np.sqrt(self.variance + self.per_level * level))


def _level_and_variance(image: U8) -> tuple[float, float]:
    """Mean level of the brighter half of an image, and the variance of its noise."""
    step, apart = max(1, round(image.size / _SAMPLES)), _STEP_PX
    if min(image.shape) <= 2 * apart:
        return 0.0, _LEAST_LEVELS**2
    rows = image.shape[0] - 2 * apart
    top, middle, bottom = (image[row : rows + row : step].astype(np.int16) for row in (0, apart, 2 * apart))
    across = top - 2 * middle + bottom
    second = across[:, : -2 * apart] - 2 * across[:, apart:-apart] + across[:, 2 * apart :]
    inner = middle[:, apart:-apart]
    usable = (inner > 0) & (inner < 255)
    if not usable.any():
        return 0.0, _LEAST_LEVELS**2
    usable &= inner >= np.median(inner[usable])
    sigma = max(_LEAST_LEVELS, _MAD * float(np.median(np.abs(second[usable]))) / 6.0)
    return float(inner[usable].mean()), sigma**2

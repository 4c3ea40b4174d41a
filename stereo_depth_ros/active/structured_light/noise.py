# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of a camera, estimated from the images of a capture."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.types import U8

__all__ = ["noise_levels"]

_LEAST_LEVELS = 0.5  # rounding to whole levels, and compression
_STEP_PX = 2  # noise of neighbors is not independent after demosaicing and compression
_MAD = 1.4826  # standard deviation of a normal variable, relative to its median absolute deviation
_SAMPLES = 200_000


def noise_levels(image: U8) -> float:
    """Standard deviation of the noise of an image, gray levels; not below that of rounding.

    The median size of the differences of second order in both directions, which edges and slopes of the scene change
    little (Immerkaer 1996, eq. 2, with the median in place of the mean). Saturated and black pixels are left out.

    Args:
        image: uint8 (H, W), of a scene that is lit evenly.
    """
    step, apart = max(1, round(image.size / _SAMPLES)), _STEP_PX
    if min(image.shape) <= 2 * apart:
        return _LEAST_LEVELS
    rows = image.shape[0] - 2 * apart
    top, middle, bottom = (image[row : rows + row : step].astype(np.int16) for row in (0, apart, 2 * apart))
    across = top - 2 * middle + bottom
    second = across[:, : -2 * apart] - 2 * across[:, apart:-apart] + across[:, 2 * apart :]
    inner = middle[:, apart:-apart]
    usable = (inner > 0) & (inner < 255)
    if not usable.any():
        return _LEAST_LEVELS
    return max(_LEAST_LEVELS, _MAD * float(np.median(np.abs(second[usable]))) / 6.0)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sampling-insensitive pixel dissimilarity of Birchfield and Tomasi."""

from __future__ import annotations

from typing import TypeAlias

import numba
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import U8

__all__ = ["COST_STEPS", "OUTSIDE", "U16", "birchfield_tomasi"]

U16: TypeAlias = npt.NDArray[np.uint16]

COST_STEPS = 2  # costs are in half gray levels, so that midpoints between pixels are integers
OUTSIDE = np.uint16(65535)


def birchfield_tomasi(left: U8, right: U8, min_disparity: int, num_disparities: int) -> U16:
    """Dissimilarity that is insensitive to image sampling (Birchfield and Tomasi 1998).

    A pixel of one image is compared with the range of linearly interpolated values within half a pixel of its partner,
    and vice versa; the smaller of the two distances is the cost. Image rows are extended by their outermost pixels.

    Args:
        left, right: uint8 (H, W), gray, rectified.
        min_disparity: disparity of index 0, px.
        num_disparities: number of disparities, one px apart.

    Returns:
        uint16 (H, W, num_disparities), in half gray levels (0 to 510); ``OUTSIDE`` where the partner of the left pixel
        is not in the right image.
    """
    costs = np.empty((*left.shape, num_disparities), np.uint16)
    images = (np.ascontiguousarray(left), np.ascontiguousarray(right))
    run_bands(_cost_rows, left.shape[0], *images, min_disparity, costs)
    return costs


@compiled()
def _interval(image: U8, y: int, low: U16, here: U16, high: U16) -> None:
    """Minimum and maximum within half a pixel of each pixel of a row, and its value, in half gray levels."""
    width = image.shape[1]
    for x in range(width):
        value = np.uint16(image[y, x])
        before = np.uint16(value + image[y, max(x - 1, 0)])
        after = np.uint16(value + image[y, min(x + 1, width - 1)])
        here[x] = np.uint16(2 * value)
        low[x] = min(before, after, here[x])
        high[x] = max(before, after, here[x])


@compiled(numba.void(numba.int64, numba.int64, READ_ONLY_U8, READ_ONLY_U8, numba.int64, numba.uint16[:, :, ::1]))
def _cost_rows(first: int, last: int, left: U8, right: U8, min_disparity: int, costs: U16) -> None:
    width, count = costs.shape[1], costs.shape[2]
    left_low, left_here, left_high = np.empty(width, np.uint16), np.empty(width, np.uint16), np.empty(width, np.uint16)
    low, here, high = np.empty(width, np.uint16), np.empty(width, np.uint16), np.empty(width, np.uint16)
    for y in range(first, last):
        _interval(left, y, left_low, left_here, left_high)
        _interval(right, y, low, here, high)
        for x in range(width):
            a_low, a, a_high = np.int32(left_low[x]), np.int32(left_here[x]), np.int32(left_high[x])
            for k in range(count):
                at = x - min_disparity - k
                if at < 0 or at >= width:
                    costs[y, x, k] = OUTSIDE
                    continue
                to_right = max(0, a - high[at], low[at] - a)
                to_left = max(0, here[at] - a_high, a_low - here[at])
                costs[y, x, k] = min(to_right, to_left)

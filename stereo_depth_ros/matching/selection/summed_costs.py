# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection by keys of summed costs: winner, second best, left-right check.

A key has a summed cost in the upper 16 bits of a uint32 and its index in the lower ones: the smallest key gives both
the lowest cost and its index, of equal costs the first.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import U8, Reason

__all__ = ["NO_KEY", "U32", "least_key", "left_right_row", "lower_keys", "second_key"]

U16: TypeAlias = npt.NDArray[np.uint16]
U32: TypeAlias = npt.NDArray[np.uint32]

NO_KEY = np.uint32(2**32 - 1)
_ONE, _TWO, _INDEX = np.uint32(1), np.uint32(2), np.uint32(0xFFFF)
_LEFT_RIGHT = np.uint8(Reason.LEFT_RIGHT)


@compiled(allocates=False)
def least_key(keys: U32) -> np.uint32:
    """The smallest key of a pixel."""
    least = NO_KEY
    for k in range(keys.size):
        least = min(least, keys[k])
    return least


@compiled(allocates=False)
def second_key(keys: U32, ramp: U32, best: int) -> np.uint32:
    """The smallest key at least two indices away from ``best``."""
    second = NO_KEY
    below = np.uint32(np.uint32(best) - _ONE)
    for k in range(keys.size):
        second = min(second, keys[k] if np.uint32(ramp[k] - below) > _TWO else NO_KEY)
    return second


@compiled(allocates=False)
def lower_keys(keys: U32, right_keys: U32) -> None:
    """Update the smallest keys of the right pixels with those of a left pixel."""
    for k in range(keys.size):
        right_keys[k] = min(right_keys[k], keys[k])


@compiled(allocates=False)
def left_right_row(best: U16, right_keys: U32, tolerance: int, reasons: U8) -> None:
    """Mark the pixels of a row whose right pixel prefers a disparity more than ``tolerance`` px away.

    Args:
        best: uint16 (W,), the index of each left pixel; index k of left pixel x is right pixel x + k.
        right_keys: uint32 (W + K,), the smallest key of each right pixel.
        reasons: uint8 (W,), 0 where valid.
    """
    for x in range(best.size):
        if reasons[x] == 0:
            k = np.int64(best[x])
            if abs(np.int64(right_keys[x + k] & _INDEX) - k) > tolerance:
                reasons[x] = _LEFT_RIGHT

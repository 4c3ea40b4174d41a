# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Products of features as matching costs, in the range of those of the census."""

from __future__ import annotations

import numba
import numpy as np
from numba import float32, int64, uint8

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8

__all__ = ["UNRELATED_COST", "copy_costs", "feature_costs"]

LARGEST = np.float32(62)
UNRELATED_COST = np.float32(40.0)  # of features at right angles; results are nearly the same from 25 to 90
NEUTRAL_COST = np.uint8(31)
_NEVER = np.uint8(255)


@compiled(numba.void(int64, int64, float32[:, :, ::1], float32[:, :, ::1], int64, float32, uint8[:, :, ::1]))
def feature_costs(
    first: int, last: int, left: F32, right: F32, max_disparity: int, unrelated: np.float32, costs: U8
) -> None:
    """Matching costs of a band of rows: (1 - cosine of the angle between the features) times a factor, at most 62.

    Index k and what is outside the right image are as of the costs of the census, see hamming_row there.

    Args:
        first, last: rows to write.
        left, right: features of unit length, float32 (H, F, W).
        max_disparity: largest disparity, px.
        unrelated: the factor, cost of features at right angles.
        costs: uint8 (H, W, K), at most 62.
    """
    depth, width = left.shape[1:]
    count = costs.shape[2]
    sums = np.empty(count, np.float32)
    for y in range(first, last):
        for x in range(width):
            at = x - max_disparity  # right column of index 0
            begin, end = min(max(-at, 0), count), max(min(width - at, count), 0)
            here = costs[y, x]
            if begin >= end:
                here[:] = NEUTRAL_COST
                continue
            total, inside = sums[begin:end], here[begin:end]
            total[:] = 0
            for c in range(depth):
                _add_products(left[y, c, x], right[y, c, at + begin : at + end], total)
            for k in range(total.size):
                cost = unrelated * (np.float32(1) - total[k])
                inside[k] = np.uint8(min(max(np.rint(cost), np.float32(0)), LARGEST))
            here[:begin] = min(here[begin], NEUTRAL_COST)
            here[end:] = min(here[end - 1], NEUTRAL_COST)


@compiled(allocates=False)
def _add_products(own: np.float32, others: F32, total: F32) -> None:
    for k in range(total.size):
        total[k] += own * others[k]


@compiled(allocates=False)
def copy_costs(costs: U8, first: int, last: int, out: U8) -> None:
    """Rows of costs into those of a strip, where there may be more disparities, which are never taken.

    Args:
        costs: uint8 (H, W, K).
        first, last: rows to copy, to ``out[0]`` and on.
        out: uint8 (rows, W, at least K).
    """
    count = costs.shape[2]
    for y in range(first, last):
        for x in range(costs.shape[1]):
            here = out[y - first, x]
            here[count:] = _NEVER
            for k in range(count):
                here[k] = costs[y, x, k]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Winners, seconds and the left-right check of keys against values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core.types import U8, Reason
from stereo_depth_ros.matching.selection.summed_costs import (
    NO_KEY,
    U32,
    least_key,
    left_right_row,
    lower_keys,
    second_key,
)


def keys_of(costs: list[int | None]) -> U32:
    """Keys of summed costs; NO_KEY for None."""
    keys = [NO_KEY if cost is None else (cost << 16) + k for k, cost in enumerate(costs)]
    return np.array(keys, np.uint32)


def test_of_equal_costs_the_first_wins() -> None:
    assert least_key(keys_of([9, 4, None, 4, 8])) == (4 << 16) + 1
    assert least_key(keys_of([None, None])) == NO_KEY


@pytest.mark.parametrize("count", [1, 2, 3, 16, 37])
def test_second_is_at_least_two_away(count: int) -> None:
    keys = keys_of([int(cost) for cost in np.random.default_rng(count).integers(0, 50, count)])
    for best in range(count):
        others = [keys[k] for k in range(count) if abs(k - best) >= 2]
        assert second_key(keys, np.arange(count, dtype=np.uint32), best) == min(others, default=NO_KEY)


def test_right_pixels_keep_the_smallest_key() -> None:
    right = keys_of([4, None, 6, 6])
    lower_keys(keys_of([5, 5, 5, None]), right)
    np.testing.assert_array_equal(right, keys_of([4, 5, 5, 6]))


@pytest.mark.parametrize(("tolerance", "rejected"), [(1, [False, True, True]), (2, [False, False, True])])
def test_left_right_check(tolerance: int, rejected: list[bool]) -> None:
    best = np.array([2, 3, 4, 5], np.uint16)  # right pixels 2, 4, 6, 8
    right_keys = np.full(9, NO_KEY, np.uint32)
    right_keys[[2, 4, 6]] = [(7 << 16) + 3, (7 << 16) + 1, (7 << 16) + 7]  # 1, 2 and 3 away
    reasons: U8 = np.array([0, 0, 0, Reason.BORDER], np.uint8)
    left_right_row(best, right_keys, tolerance, reasons)
    np.testing.assert_array_equal(reasons, [*(Reason.LEFT_RIGHT * no for no in rejected), Reason.BORDER])

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Winners, seconds, the sub-pixel fit and the left-right check against closed forms and values computed by hand."""

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
    make_keys,
    second_key,
    subpixel,
)


def keys_of(costs: list[int | None]) -> U32:
    """Keys of summed costs; NO_KEY for None."""
    keys = [NO_KEY if cost is None else (cost << 16) + k for k, cost in enumerate(costs)]
    return np.array(keys, np.uint32)


def test_keys_hold_the_sum_and_the_index() -> None:
    rng = np.random.default_rng(0)
    totals = rng.integers(0, 7 * 255 + 1, 4096).astype(np.uint16)  # eight paths, all disparities
    path = rng.integers(0, 256, 4098).astype(np.uint8)
    totals[-1], path[-2] = 7 * 255, 255
    keys = np.empty(4096, np.uint32)
    make_keys(totals, path, np.arange(4096, dtype=np.uint32), keys)
    np.testing.assert_array_equal(keys >> 16, totals.astype(int) + path[1:-1])
    np.testing.assert_array_equal(keys & 0xFFFF, np.arange(4096))


def test_of_equal_costs_the_first_wins() -> None:
    assert least_key(keys_of([9, 4, None, 4, 8])) == (4 << 16) + 1
    assert least_key(keys_of([None, None])) == NO_KEY


@pytest.mark.parametrize("count", [1, 2, 3, 16, 37])
def test_second_is_at_least_two_away(count: int) -> None:
    keys = keys_of([int(cost) for cost in np.random.default_rng(count).integers(0, 50, count)])
    for best in range(count):
        others = [keys[k] for k in range(count) if abs(k - best) >= 2]
        assert second_key(keys, np.arange(count, dtype=np.uint32), best) == min(others, default=NO_KEY)


@pytest.mark.parametrize(
    ("costs", "u"),
    [
        ([9, 5, 9], 0.0),
        ([9, 5, 7], 0.25),
        ([7, 5, 9], -0.25),
        ([9, 5, 5], 0.5),  # halfway, which keeps its place
        ([105, 5, 85], 0.1),
        ([2000, 0, 1000], 0.25),
        ([5, 5, 5], 0.0),
    ],
)
def test_subpixel_is_the_intersection_corrected_for_pixel_locking(costs: list[int | None], u: float) -> None:
    expected = u * (1 + (1 - 4 * u**2) / 4)
    assert subpixel(keys_of([60, *costs, 60]), 2) == pytest.approx(expected, abs=1e-12)


def test_subpixel_keeps_order_and_stays_in_the_pixel() -> None:
    # From a valley in the middle to one that the next index shares.
    parts = [subpixel(keys_of([150, 50, after]), 1) for after in range(150, 49, -1)]
    assert parts[0] == 0 and parts[-1] == 0.5
    assert (np.diff(parts) > 0).all()


@pytest.mark.parametrize(
    ("costs", "best"), [([1, 2, 3], 0), ([3, 2, 1], 2), ([None, 1, 2], 1), ([2, 1, None], 1), ([1], 0)]
)
def test_no_subpixel_without_both_neighbors(costs: list[int | None], best: int) -> None:
    assert subpixel(keys_of(costs), best) == 0


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

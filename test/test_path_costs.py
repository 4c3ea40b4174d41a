# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Path costs in 8 bits against the recurrence in 64."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.costs.census import LARGEST_COST, padded_count
from stereo_depth_ros.matching.costs.windows import whole_range
from stereo_depth_ros.matching.sgm.cost_rows import LARGEST_SMOOTHED
from stereo_depth_ros.matching.sgm.path_costs import LARGEST_PATH_COST, path_step, start_path, step_row

I64 = npt.NDArray[np.int64]


def step_by_definition(before: I64, cost: I64, P1: int, P2: int) -> I64:
    """Equation 13 of Hirschmueller 2008 for all disparities of a pixel, in int64."""
    far = 1 << 40
    padded = np.concatenate(([far], before, [far]))
    ways = [before, padded[:-2] + P1, padded[2:] + P1, np.full_like(before, before.min() + P2)]
    step: I64 = cost + np.min(ways, axis=0) - before.min()
    return step


def path_by_definition(cost: I64, image: U8, P1: int, P2: I64, dy: int, dx: int) -> I64:
    """int64 (H, W, K): path costs of a whole image in the direction (dy, dx); P2 by the gray difference."""
    height, width, _ = cost.shape
    path = cost.copy()
    for y in range(height)[:: -1 if dy < 0 else 1]:
        for x in range(width)[:: -1 if dx < 0 else 1]:
            if 0 <= y - dy < height and 0 <= x - dx < width:
                edge = abs(int(image[y, x]) - int(image[y - dy, x - dx]))
                path[y, x] = step_by_definition(path[y - dy, x - dx], cost[y, x], P1, int(P2[edge]))
    return path


def filled(costs: I64) -> U8:
    """Costs (..., K) with those that fill the last vector."""
    count = costs.shape[-1]
    size = padded_count(count)
    whole = np.full((*costs.shape[:-1], size), LARGEST_COST, np.uint8)
    whole[..., :count] = costs
    return whole


@pytest.mark.parametrize("count", [1, 2, 37, 64, 100, 192])
@pytest.mark.parametrize(("P1", "P2"), [(1, 184), (90, 95), (30, 150), (5, 5)])
@pytest.mark.parametrize("in_place", [False, True])
def test_steps_along_a_path(count: int, P1: int, P2: int, in_place: bool) -> None:
    rng = np.random.default_rng(count)
    costs = rng.choice([0, 1, 20, 31, LARGEST_SMOOTHED], (150, count), p=[0.2, 0.1, 0.2, 0.1, 0.4])
    before, after = np.zeros((2, padded_count(count)), np.uint8)
    size = before.size
    least = start_path(filled(costs[0]), 0, size, before, 0)
    expected = costs[0].astype(np.int64)
    for cost in costs[1:]:
        assert least == expected.min()
        np.testing.assert_array_equal(before, filled(expected))
        given = (before, 0, np.uint8(least), filled(cost), 0, size, np.uint8(P1), np.uint8(P2))
        least = path_step(*given, before if in_place else after, 0)
        expected = step_by_definition(expected, cost.astype(np.int64), P1, P2)
        if not in_place:
            before, after = after, before


def test_a_step_at_the_largest_penalties_fills_8_bits() -> None:
    P1, P2 = 1, LARGEST_PATH_COST - LARGEST_SMOOTHED - 1
    path = filled(np.array([0, 255 - P1, 255 - P1, 255 - P1, 255 - P1]))
    costs, penalties = filled(np.full(5, LARGEST_SMOOTHED)), (np.uint8(P1), np.uint8(P2))
    path_step(path, 0, np.uint8(0), costs, 0, path.size, *penalties, path, 0)
    np.testing.assert_array_equal(path, filled(np.array([70, 71, 254, 254, 254])))


@pytest.mark.parametrize("shift", [0, 1, -1])
def test_rows_of_an_image(shift: int) -> None:
    height, width, count, P1 = 6, 11, 16, 20
    rng = np.random.default_rng(4)
    image = rng.integers(0, 256, (height, width), np.uint8)
    cost = rng.integers(0, LARGEST_SMOOTHED + 1, (height, width, count))
    P2 = np.linspace(170, P1, 256).astype(np.uint8)
    path, least = np.zeros_like(filled(cost)), np.zeros((height, width), np.uint8)
    for y in range(height):
        above = max(y - 1, 0)
        columns = shift if y > 0 else width  # further than the row is long: all paths begin
        rows = (image[y], image[above], columns, filled(cost[y]))
        penalties = np.uint8(P1), P2
        step_row(
            *rows,
            *penalties,
            path[above],
            least[above],
            path[y],
            least[y],
            whole_range(1, width, padded_count(count)),
            0,
            0,
        )
    expected = path_by_definition(cost.astype(np.int64), image, P1, P2.astype(np.int64), 1, shift)
    np.testing.assert_array_equal(path, filled(expected))
    np.testing.assert_array_equal(least, expected.min(axis=2))

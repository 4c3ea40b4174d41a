# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of path costs, winners, seconds, the sub-pixel fit and the left-right check against definitions."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.core.types import U8, U16, Reason
from stereo_depth_ros.matching.sgm.winners import (
    NO_SUM,
    add_diagonals,
    add_paths,
    agree_row,
    lower_right,
    subpixel,
    take_winner,
)

I64 = npt.NDArray[np.int64]


@numba.njit
def _take(sums: U16, winners: U16) -> None:
    take_winner(sums, 0, sums.size, np.uint16(min(sums[0].min(), sums[1].min())), 1, winners)


@numba.njit
def _subpixel(before: np.uint16, here: np.uint16, after: np.uint16) -> float:
    return subpixel(before, here, after)


def winner(sums: U16) -> list[int]:
    """Index, sum, second best, and the sums of both neighbors."""
    winners = np.full((5, 3), 9, np.uint16)
    _take(sums, winners)
    assert (winners[:, [0, 2]] == 9).all()
    return winners[:, 1].tolist()  # type: ignore[no-any-return]


@numba.njit
def _add(left: U8, right: U8, down: U8, up: U8, x: int, begin: int, end: int, sums: U16) -> int:
    size, diagonals = left.size, len(down) > 1
    if diagonals:
        add_diagonals(down, 1, up, 0, x, sums)
    vertical = len(down) // 2  # of all three
    down_at = ((vertical * down.shape[1] + 1) * down.shape[2] + x) * size
    up_at = (len(up) // 2 * up.shape[1] * up.shape[2] + x) * size
    return add_paths(left, 0, right, 0, down, down_at, up, up_at, size, begin, end, diagonals, sums)


@numba.njit
def _lower_row(sums: U16, right_sums: U16, right_indices: U16) -> None:
    right_sums[:] = NO_SUM
    for j in range(len(sums)):
        x = len(sums) - 1 - j
        lower_right(sums[x], 0, 2 * sums.shape[2], x, right_sums, right_indices)


@numba.njit
def _agree(best: U16, right_indices: U16, tolerance: int, reasons: U8) -> None:
    agree_row(best, right_indices, tolerance, reasons)


def split(sums: I64) -> U16:
    """As the kernels have them: even indices, odd indices."""
    return np.stack([sums[..., ::2], sums[..., 1::2]], axis=-2).astype(np.uint16)


def sums_of(costs: list[int | None], first: int = 0) -> U16:
    """Sums of a pixel from index ``first`` on; ``NO_SUM`` for None and elsewhere."""
    sums = np.full(128, NO_SUM, np.int64)
    sums[first : first + len(costs)] = [NO_SUM if cost is None else cost for cost in costs]
    return split(sums)


@pytest.mark.parametrize("directions", [1, 3])
@pytest.mark.parametrize(("begin", "end"), [(0, 128), (3, 128), (0, 77), (66, 70), (90, 40)])
def test_sums_of_paths_inside_the_right_image(directions: int, begin: int, end: int) -> None:
    rng = np.random.default_rng(directions)
    left, right = rng.integers(0, 256, (2, 128), np.uint8)
    down, up = rng.integers(0, 256, (2, directions, 2, 5, 128), np.uint8)
    sums = np.zeros((2, 64), np.uint16)
    least = _add(left, right, down, up, 4, begin, end, sums)
    total = left.astype(int) + right + down[:, 1, 4].sum(axis=0, dtype=int) + up[:, 0, 4].sum(axis=0, dtype=int)
    inside = (np.arange(128) >= begin) & (np.arange(128) < end)
    np.testing.assert_array_equal(sums, split(np.where(inside, total, NO_SUM)))
    assert least == sums.min()


def test_no_paths_from_below() -> None:
    left, right = np.arange(64, dtype=np.uint8), np.full(64, 150, np.uint8)
    down, none = np.full((1, 2, 1, 64), 50, np.uint8), np.zeros((0, 2, 1, 64), np.uint8)
    sums = np.zeros((2, 32), np.uint16)
    assert _add(left, right, down, none, 0, 0, 64, sums) == 200
    np.testing.assert_array_equal(sums, split(np.arange(200, 264)))


@pytest.mark.parametrize(
    ("costs", "first", "best"),
    [
        ([9, 4, None, 4, 8], 0, 1),  # of equal costs the first wins
        ([9, 4, None, 4, 8], 63, 64),
        ([4, 4], 63, 63),
        ([4, 4], 20, 20),
        ([5, 4], 126, 127),
    ],
)
def test_of_equal_sums_the_first_wins(costs: list[int | None], first: int, best: int) -> None:
    assert winner(sums_of(costs, first))[:2] == [best, 4]


@pytest.mark.parametrize("count", [1, 2, 3, 16, 37, 128])
def test_second_is_at_least_two_away(count: int) -> None:
    rng = np.random.default_rng(count)
    for best in range(count):
        costs = [int(cost) for cost in rng.integers(10, 50, count)]
        costs[best] = 3
        others = [costs[k] for k in range(count) if abs(k - best) >= 2]
        found = winner(sums_of([*costs]))
        assert found[:3] == [best, 3, min(others, default=NO_SUM)]
        assert best == 0 or found[3] == costs[best - 1]
        assert best == count - 1 or found[4] == costs[best + 1]


@pytest.mark.parametrize(
    ("sums", "u"),
    [
        ((9, 5, 9), 0.0),
        ((9, 5, 7), 0.25),
        ((7, 5, 9), -0.25),
        ((9, 5, 5), 0.5),  # halfway, which keeps its place
        ((105, 5, 85), 0.1),
        ((2000, 0, 1000), 0.25),
        ((5, 5, 5), 0.0),
        ((NO_SUM, 1, 2), 0.0),  # no subpixel without both neighbors
        ((2, 1, NO_SUM), 0.0),
        ((NO_SUM, NO_SUM, NO_SUM), 0.0),
    ],
)
def test_subpixel_is_the_intersection_corrected_for_pixel_locking(sums: tuple[int, int, int], u: float) -> None:
    expected = u * (1 + 0.45 * (1 - 4 * u**2))
    assert _subpixel(*np.array(sums, np.uint16)) == pytest.approx(expected, abs=1e-12)


def test_subpixel_keeps_order_and_stays_in_the_pixel() -> None:
    # From a valley in the middle to one that the next index shares.
    parts = [_subpixel(*np.array([150, 50, after], np.uint16)) for after in range(150, 49, -1)]
    assert parts[0] == 0 and parts[-1] == 0.5
    assert (np.diff(parts) > 0).all()


def test_right_pixels_keep_the_smallest_sum_and_of_equal_ones_the_smallest_index() -> None:
    width, count = 23, 64
    rng = np.random.default_rng(7)
    sums = rng.integers(0, 9, (width, count))
    sums[rng.random(sums.shape) < 0.2] = NO_SUM
    right_sums, right_indices = np.zeros((2, 2, (width + count) // 2 + 1), np.uint16)
    _lower_row(split(sums), right_sums, right_indices)
    for at in range(width + count - 1):
        offers = [(int(sums[x, at - x]), at - x) for x in range(width) if 0 <= at - x < count]
        least, index = min(offers)
        assert right_sums[at % 2, at // 2] == least
        assert least == NO_SUM or right_indices[at % 2, at // 2] == index


@pytest.mark.parametrize(("tolerance", "rejected"), [(1, [False, True, True]), (2, [False, False, True])])
def test_left_right_check(tolerance: int, rejected: list[bool]) -> None:
    best = np.array([2, 3, 4, 5], np.uint16)  # right pixels 2, 4, 6, 8
    right_indices = np.zeros((2, 9), np.uint16)
    right_indices[0, [1, 2, 3]] = [3, 1, 7]  # 1, 2 and 3 away
    reasons: U8 = np.array([0, 0, 0, Reason.BORDER], np.uint8)
    _agree(best, right_indices, tolerance, reasons)
    np.testing.assert_array_equal(reasons, [*(Reason.LEFT_RIGHT * no for no in rejected), Reason.BORDER])

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothed costs against the definitions in numpy: (1 2 1) / 4, and recursions along the edges of the image."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from test_census import costs_by_definition, planes, with_grays

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.costs.census import CENSUS_BITS, LARGEST_COST, padded_count
from stereo_depth_ros.matching.costs.permeability import GROUP, permeabilities, permeability_rows
from stereo_depth_ros.matching.costs.windows import whole_range
from stereo_depth_ros.matching.sgm.cost_rows import LARGEST_SMOOTHED, View, cost_rows, first_needed
from stereo_depth_ros.matching.sgm.strips import Scratch

I64 = npt.NDArray[np.int64]
F32 = npt.NDArray[np.float32]


def plainly_smoothed(raw: I64) -> I64:
    """In half bits: (before + after) / 2 + here along x, then the mean of that mean and here along y, rounded up."""
    before, after = raw[:, [0, *range(raw.shape[1] - 1)]], raw[:, [*range(1, raw.shape[1]), -1]]
    along = (before + after + 1) // 2 + raw
    above, below = along[[0, *range(len(raw) - 1)]], along[[*range(1, len(raw)), -1]]
    return ((above + below + 1) // 2 + along + 1) // 2


def shares(image: U8, axis: int) -> I64:
    """(H, W): what passes from the pixel before, of 65536; 0 for the first one."""
    steps = np.abs(np.diff(image.astype(int), axis=axis))
    passed = np.array([round(65536 * 0.9 * math.exp(-step / 4)) for step in steps.ravel()], np.int64).reshape(
        steps.shape
    )
    return np.pad(passed, ((1, 0), (0, 0)) if axis == 0 else ((0, 0), (1, 0)))


def weighted_means(costs: I64, passed: I64, last: int, gain: float) -> I64:
    """Along axis 0 of (N, ..., K), each element with all before it and those after it up to ``last``, times gain.

    Sums are in sixteenths, products cut off; the weights are sums of ones in float32.
    """
    share = passed.astype(np.float32) * np.float32(1 / 65536)
    beyond, weight_beyond = np.zeros_like(costs), np.zeros(share.shape, np.float32)
    for i in range(last - 1, -1, -1):
        beyond[i] = (16 * costs[i + 1] + beyond[i + 1]) * passed[i + 1, ..., None] >> 16
        weight_beyond[i] = (np.float32(1) + weight_beyond[i + 1]) * share[i + 1]
    means = np.zeros_like(costs)
    total, weight = np.zeros_like(costs[0]), np.zeros(share.shape[1:], np.float32)
    for i in range(len(costs)):
        total = 16 * costs[i] + (total * passed[i, ..., None] >> 16)
        weight = np.float32(1) + weight * share[i]
        scale = np.rint(np.float32(65536 * gain / 16) / (weight + weight_beyond[i])).astype(np.int64)
        means[i] = (total + beyond[i]) * scale[..., None] >> 16
    return means


def permeably_smoothed(raw: I64, image: U8, top: int = 0) -> I64:
    """Rows from ``top`` on: along x all pixels, along y all rows from there to the end of the next group."""
    along = weighted_means(raw.swapaxes(0, 1), shares(image, 1).T, raw.shape[1] - 1, 4).swapaxes(0, 1)
    passed = shares(image, 0)[top:]
    passed[0] = 0
    smoothed = np.zeros_like(along[top:])
    for first in range(0, len(smoothed), GROUP):
        last = min(first + 2 * GROUP, len(smoothed)) - 1
        means = weighted_means(along[top:][: last + 1], passed[: last + 1], last, 0.5)
        smoothed[first : first + GROUP] = means[first : first + GROUP]
    return smoothed


def view_of(
    image: U8, left: npt.NDArray[np.uint64], right: npt.NDArray[np.uint64], other: U8 | None = None, count: int = 16
) -> View:
    """What is computed of an image with these codes, and of the other one, which is the same if not given."""
    height, width = image.shape
    along, scales = np.zeros((2, height, width), np.uint16)
    down = np.zeros((height + 2 * GROUP, width), np.uint16)
    permeability_rows(0, height, image, permeabilities(), along, scales, down)
    census = planes(np.stack([left, right])[None])
    with_grays(census[0, 0], image)
    with_grays(census[0, 1], image if other is None else other)
    return View(census, along, scales, down, whole_range(height, width, padded_count(count)))


def costs(view: View, top: int, max_disparity: int, count: int, edge_aware: bool) -> U8:
    """Costs of the rows from ``top`` on."""
    height, width = view.along.shape
    buffers = Scratch.allocate(height, width, count, 3, edge_aware).costs
    out = np.full((height + GROUP, width, padded_count(count)), 77, np.uint8)
    done = first_needed(top, edge_aware) - 1
    for first in range(top, height, GROUP):
        given = (max_disparity, count, edge_aware, view, buffers)
        done = cost_rows(first, first == top, done, *given, out[first : first + GROUP])
    assert (out[top:height, :, count:] == LARGEST_COST).all()
    return out[top:height, :, :count]


@pytest.mark.parametrize("edge_aware", [False, True])
@pytest.mark.parametrize(
    ("shape", "max_disparity", "count"),
    [
        ((23, 40), 31, 32),
        ((6, 23), 5, 80),  # both ends of the range leave the image
        ((9, 9), -12, 64),  # no pixel sees any
        ((1, 19), 8, 16),
        ((18, 1), 7, 16),
    ],
)
def test_costs_are_those_of_the_definition(
    edge_aware: bool, shape: tuple[int, int], max_disparity: int, count: int
) -> None:
    rng = np.random.default_rng(shape[1])
    image = rng.choice([0, 3, 7, 250], shape, p=[0.4, 0.3, 0.2, 0.1]).astype(np.uint8)
    left, right = (rng.integers(0, 1 << CENSUS_BITS, shape, np.uint64) for _ in range(2))
    other = image[:, ::-1].copy()
    raw = costs_by_definition(left, right, max_disparity, count, (image, other) if edge_aware else None)
    for top in range(0, shape[0], 8):  # strips
        expected = permeably_smoothed(raw, image, top) if edge_aware else plainly_smoothed(raw)[top:]
        found = costs(view_of(image, left, right, other, count), top, max_disparity, count, edge_aware)
        np.testing.assert_array_equal(found, expected)
        assert found.max() <= LARGEST_SMOOTHED


@pytest.mark.parametrize("edge_aware", [False, True])
def test_equal_costs_stay_and_none_is_above_the_largest(edge_aware: bool) -> None:
    image = np.full((21, 70), 90, np.uint8)  # everything passes as far as it can
    zero, full = np.zeros(image.shape, np.uint64), np.full(image.shape, (1 << CENSUS_BITS) - 1, np.uint64)
    view = view_of(image, zero, full, np.zeros_like(image))
    found = costs(view, 0, 0, 16, edge_aware)[:, :, 0]  # disparity 0, the same for all pixels
    largest = LARGEST_SMOOTHED if edge_aware else 2 * CENSUS_BITS
    assert found.min() >= largest - 3 and found.max() <= largest


def test_edge_aware_costs_do_not_cross_edges() -> None:
    image = np.zeros((20, 60), np.uint8)
    image[:, 30:] = 200
    left = np.zeros(image.shape, np.uint64)
    right = np.zeros(image.shape, np.uint64)
    right[:, 30:] = (1 << CENSUS_BITS) - 1
    smooth, plain = (costs(view_of(image, left, right), 0, 0, 16, aware)[10, :, 0] for aware in (True, False))
    assert smooth[29] == 0 and smooth[30] >= 2 * CENSUS_BITS - 3
    assert plain[29] > 8 and plain[30] < 2 * CENSUS_BITS - 8


@pytest.mark.parametrize(("first", "last"), [(0, 19), (0, 1), (5, 18)])
def test_permeabilities_of_some_rows(first: int, last: int) -> None:
    image = np.random.default_rng(3).integers(90, 110, (19, 31), np.uint8)
    along, scales = np.full((2, 19, 31), 7, np.uint16)
    down = np.full((19 + 2 * GROUP, 31), 7, np.uint16)
    permeability_rows(first, last, image, permeabilities(), along, scales, down)
    np.testing.assert_array_equal(along[first:last], shares(image, 1)[first:last])
    np.testing.assert_array_equal(down[first:last], shares(image, 0)[first:last])
    for array in (along, scales, down):
        assert (array[:first] == 7).all() and (array[last:] == 7).all()

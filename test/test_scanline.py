# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scanlines against exhaustive search over paths and columns, and on real pairs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import middlebury2001
import numpy as np
import pytest

from stereo_depth_ros.core.types import Reason
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.global_methods import scanline
from stereo_depth_ros.matching.global_methods.global_matcher import NO_LABEL
from stereo_depth_ros.matching.global_methods.scanline import FAR


def path_cost(labels: tuple[int, ...], costs: np.ndarray, gaps: np.ndarray, occlusion: int) -> float:
    """What a labeling of one row costs by the rules of a path; infinite where it breaks one.

    The right pixel of label k is x - k + a constant. Between two matches, the left pixels (or else the right ones) that
    lie between them are occluded. Before the first match and behind the last, left pixels are occluded one by one.
    """
    count = costs.shape[1] - 1
    matches = [(x, k) for x, k in enumerate(labels) if k != NO_LABEL]
    total = float(sum(costs[x, count] for x, k in enumerate(labels) if k == NO_LABEL))
    total += sum(costs[x, k] for x, k in matches)
    if not matches or total >= FAR:
        return float("inf")
    first, last = matches[0], matches[-1]
    begin = first[1] - first[0]  # the label at which the path enters the row
    if begin < 0 or costs[0, begin] >= FAR or last[1] + len(labels) - 1 - last[0] >= count:
        return float("inf")
    if first[0] > 0:
        total += gaps[first[0] - 1]
    for (x, k), (next_x, next_k) in itertools.pairwise(matches):
        left_only, right_only = next_x - x - 1, next_x - next_k - (x - k) - 1
        if right_only < 0 or (left_only > 0 and right_only > 0):
            return float("inf")
        total += gaps[next_x - 1] * (left_only + right_only > 0) + occlusion * right_only
    return total


@pytest.mark.parametrize("seed", range(8))
def test_path_has_the_lowest_cost_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    width, count, occlusion = 6, 4, int(rng.integers(3, 9))
    costs = rng.integers(0, 12, (1, width, count + 1)).astype(np.int32)
    costs[0, :, count] += occlusion // 2
    if seed % 2:  # the left edge of an image searched from disparity 0
        for x in range(count):
            costs[0, x, x + 1 : count] = FAR
    gaps = rng.integers(0, 6, (1, width)).astype(np.int32)
    labels = np.full((1, width), 99, np.int32)
    scanline._path_rows(0, 1, costs, gaps, occlusion, labels)
    every = itertools.product(range(NO_LABEL, count), repeat=width)
    least = min(path_cost(candidate, costs[0], gaps[0], occlusion) for candidate in every)
    assert path_cost(tuple(int(k) for k in labels[0]), costs[0], gaps[0], occlusion) == least < FAR


def columns(data: np.ndarray, weights: np.ndarray, occlusion: int, largest_step: int) -> Iterator[tuple[tuple, int]]:
    """All labelings of one column, the last label being "occluded", and what each costs."""
    height, count = data.shape
    for labels in itertools.product(range(count + 1), repeat=height):
        total = sum(occlusion if k == count else int(data[y, k]) for y, k in enumerate(labels))
        for y in range(height - 1):
            steps = largest_step if count in labels[y : y + 2] else min(abs(labels[y] - labels[y + 1]), largest_step)
            total += int(weights[y]) * (0 if labels[y] == labels[y + 1] else steps)
        yield labels, total


@pytest.mark.parametrize("seed", range(4))
def test_columns_have_the_minimum_sum_for_every_label(seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width, count, occlusion = 4, 2, 4, 9
    data = rng.integers(0, 20, (height, width, count)).astype(np.int32)
    data[2, 1, 3] = 70  # above the largest cost: outside the right image
    weights = rng.integers(0, 7, (height, width)).astype(np.int32)
    costs = np.empty((height, width, count + 1), np.int32)
    scanline._column_costs(0, width, data, weights, 2, 20, occlusion, costs)
    for x in range(width):
        least = np.full((height, count + 1), 10**6)
        for labels, total in columns(data[:, x], weights[:, x], occlusion, 2):
            for y, k in enumerate(labels):
                least[y, k] = min(least[y, k], total)
        outside = np.c_[data[:, x] > 20, np.zeros(height, bool)]
        assert (costs[:, x][outside] == FAR).all()
        for y in range(height):
            inside = ~outside[y]
            difference = least[y, inside] - costs[y, x, inside]
            assert (difference == difference[0]).all()  # the constant that is omitted


def test_pixels_have_one_partner_and_keep_their_order() -> None:
    rng = np.random.default_rng(2)
    left, right = rng.integers(0, 256, (2, 40, 120)).astype(np.uint8)  # nothing to find
    result = create_matcher("scanline", num_disparities=48, min_disparity=-20, speckle_size=0).match(left, right)
    for row in result.disparity_px:
        x = np.flatnonzero(np.isfinite(row))
        partners = x - row[x]
        assert (np.diff(partners) > 0).all() and partners.min() >= 0 and partners.max() < 120
    assert 0 < result.reason_counts()["NO_MATCH"] < 40 * 120


def test_occluded_pixels_have_no_disparity() -> None:
    rng = np.random.default_rng(4)
    wall, bar = rng.integers(0, 256, (50, 200)), rng.integers(0, 256, (50, 30))
    left, right = wall[:, :140].copy(), wall[:, 3:143].copy()  # wall at disparity 3
    left[:, 60:90], right[:, 49:79] = bar, bar  # bar at 11: it hides 52..59 of the left image
    left, right = left.astype(np.uint8), right.astype(np.uint8)
    result, filled = (
        create_matcher("scanline", num_disparities=32, fill_holes=fill).match(left, right) for fill in (False, True)
    )
    assert np.mean(result.reasons[:, 52:60] == Reason.NO_MATCH) > 0.95
    assert np.mean(result.disparity_px[:, 60:90] == 11) > 0.98
    # The wall left of 3 is not in the right image; its pixels may match by chance, a gap having its price.
    assert np.mean(result.reasons[:, 4:51] == 0) > 0.98

    # Filled holes are of the wall, the rest is as before.
    assert filled.valid_fraction == 1
    assert np.mean(filled.disparity_px[:, 52:60] == 3) > 0.95
    np.testing.assert_array_equal(filled.disparity_px[result.reasons == 0], result.disparity_px[result.reasons == 0])
    assert filled.confidence is not None and (filled.confidence[result.reasons != 0] == 0).all()
    assert (filled.confidence[result.reasons == 0] > 0).mean() > 0.9


def test_consistent_scanlines_outperform_independent_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(9)
    wall = rng.normal(120, 6, (60, 180))  # hardly more contrast than noise
    left, right = wall[:, :150], wall[:, 7:157]
    left, right = (np.rint(image + rng.normal(0, 5, image.shape)).astype(np.uint8) for image in (left, right))
    matcher = create_matcher("scanline", num_disparities=32, speckle_size=0, smoothness=3.0)

    def wrong() -> float:
        return float(np.mean(matcher.match(left, right).disparity_px[:, 7:] != 7))

    together = wrong()
    monkeypatch.setattr(scanline, "CONSISTENCY", 0.0)
    assert together < 0.01 and together < 0.25 * wrong()


@pytest.mark.real_data
@pytest.mark.parametrize("name", ["tsukuba", "venus"])
def test_real_scanlines_independent_and_consistent(
    name: str, stereo_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = middlebury2001.scene(name, stereo_data)
    together = middlebury2001.matched("scanline", name, stereo_data, fill_holes=True).result
    monkeypatch.setattr(scanline, "CONSISTENCY", 0.0)
    matcher = create_matcher("scanline", num_disparities=32, speckle_size=0, fill_holes=True)
    alone = matcher.match(of.left, of.right)
    assert middlebury2001.bad(together.disparity_px, of) < 0.7 * middlebury2001.bad(alone.disparity_px, of)

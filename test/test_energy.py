# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The energy against explicit sums, and its model."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.matching.costs.birchfield_tomasi import OUTSIDE, birchfield_tomasi
from stereo_depth_ros.matching.global_methods.energy import (
    StereoModel,
    energy,
    neighbor_weights,
    searched_columns,
    stereo_model,
)


def test_energy_of_six_pixels_by_hand() -> None:
    data = np.zeros((2, 3, 5), np.int32)
    labels = np.array([[0, 1, 4], [0, 0, 4]], np.int32)
    data[0, 2, 4], data[1, 1, 0], data[1, 1, 1] = 7, 2, 100  # the last is not of a label in use
    weights = np.zeros((2, 2, 3), np.int32)
    weights[0] = [[10, 20, 0], [30, 40, 0]]
    weights[1] = [[1, 3, 5], [0, 0, 0]]
    # Data 7 + 2. To the right 10 * 1 + 20 * min(3, 2), 30 * 0 + 40 * min(4, 2). Down 1 * 0 + 3 * 1 + 5 * 0.
    assert energy(StereoModel(data, weights, 2, 100), labels) == (9 + 50 + 80 + 3) / 2


def test_energy_is_the_sum_over_pixels_and_edges() -> None:
    rng = np.random.default_rng(3)
    data = rng.integers(0, 50, (5, 7, 6)).astype(np.int32)
    weights = rng.integers(1, 9, (2, 5, 7)).astype(np.int32)
    weights[0, :, -1] = weights[1, -1] = 0
    labels = rng.integers(0, 6, (5, 7)).astype(np.int32)
    total = 0
    for y, x in np.ndindex(5, 7):
        total += int(data[y, x, labels[y, x]])
        if x < 6:
            total += int(weights[0, y, x]) * min(abs(int(labels[y, x]) - int(labels[y, x + 1])), 3)
        if y < 4:
            total += int(weights[1, y, x]) * min(abs(int(labels[y, x]) - int(labels[y + 1, x])), 3)
    assert energy(StereoModel(data, weights, 3, 50), labels) == total / 2


def test_weights_are_halved_across_edges_of_the_image() -> None:
    image = np.array([[100, 115, 131], [100, 99, 90]], np.uint8)
    # Steps to the right: 15, 16 | 1, 9. Down: 0, 16, 41. An edge is 16 gray levels or more; 3 levels are 6 half ones.
    np.testing.assert_array_equal(neighbor_weights(image, 3.0), [[[12, 6, 0], [12, 12, 0]], [[12, 6, 6], [0, 0, 0]]])


@pytest.mark.parametrize(("min_disparity", "columns"), [(0, (0, 60)), (4, (4, 60)), (-20, (0, 60)), (-40, (0, 51))])
def test_model_covers_the_columns_with_a_disparity_in_the_right_image(
    min_disparity: int, columns: tuple[int, int]
) -> None:
    rng = np.random.default_rng(5)
    left, right = rng.integers(0, 256, (2, 6, 60)).astype(np.uint8)
    # Windows of one pixel match nothing, so that the gray offset stays.
    config = MatchingConfig(min_disparity=min_disparity, num_disparities=32, correlation_window_size=1)
    assert searched_columns(config, 60) == slice(*columns)
    model = stereo_model(left, right, config)
    costs = birchfield_tomasi(left, right, min_disparity, 32)
    outside = costs == OUTSIDE
    searched = ~outside.all(axis=(0, 2))
    np.testing.assert_array_equal(np.flatnonzero(searched), np.arange(*columns))
    np.testing.assert_array_equal(model.data > model.largest_cost, outside[:, searched])
    np.testing.assert_array_equal(
        model.data[~outside[:, searched]], np.minimum(costs[:, searched][~outside[:, searched]], 30)
    )
    assert model.data.shape == (6, columns[1] - columns[0], 32) and model.largest_cost == 30


@pytest.mark.parametrize("smoothness", [0.0, 0.5, 1000.0])
def test_no_neighbors_make_a_pixel_leave_the_right_image(smoothness: float) -> None:
    rng = np.random.default_rng(6)
    left, right = rng.integers(0, 256, (2, 4, 50)).astype(np.uint8)
    config = MatchingConfig(num_disparities=32, smoothness=smoothness, correlation_window_size=1)
    model = stereo_model(left, right, config)
    forbidden = model.data[model.data > model.largest_cost]
    assert (forbidden > model.largest_cost + 4 * model.largest_step * model.weights.max()).all() and forbidden.size
    assert model.weights.max() == (2 * 2 * (smoothness or 1.5))

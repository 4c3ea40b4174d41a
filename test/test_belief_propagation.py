# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Belief propagation where it is exact, and its coarser grids."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.matching.global_methods import belief_propagation
from stereo_depth_ros.matching.global_methods.belief_propagation import BeliefPropagationMatcher
from stereo_depth_ros.matching.global_methods.energy import StereoModel, energy


def random_model(seed: int, height: int, width: int, count: int) -> StereoModel:
    rng = np.random.default_rng(seed)
    data = rng.integers(0, 1000, (height, width, count)).astype(np.int32)
    weights = rng.integers(1, 300, (2, height, width)).astype(np.int32)
    weights[0, :, -1] = weights[1, -1] = 0
    return StereoModel(data, weights, 1 + seed % 3, 1000)


@pytest.mark.parametrize("shape", [(1, 6), (6, 1)])
@pytest.mark.parametrize("seed", range(4))
def test_a_chain_of_pixels_has_minimum_energy(seed: int, shape: tuple[int, int]) -> None:
    model = random_model(seed, *shape, 4)
    matcher = BeliefPropagationMatcher(MatchingConfig())
    labels = matcher._label(model)
    every = itertools.product(range(4), repeat=6)
    least = min(energy(model, np.reshape(candidate, shape).astype(np.int32)) for candidate in every)
    # Random costs up to 1000 have one best labeling, so the best label of each pixel is that of the whole.
    assert energy(model, labels) == matcher.energies[-1] == least


@pytest.mark.parametrize(("height", "width"), [(6, 8), (5, 7), (1, 4), (5, 1), (1, 1)])
def test_coarser_energy_is_that_of_labelings_constant_on_blocks(height: int, width: int) -> None:
    model = random_model(1, height, width, 5)
    coarser = belief_propagation._coarser(model)
    labels = np.random.default_rng(2).integers(0, 5, coarser.data.shape[:2]).astype(np.int32)
    fine = labels.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]
    assert energy(coarser, labels) == energy(model, fine)
    assert not coarser.weights[0, :, -1].any() and not coarser.weights[1, -1].any()


def test_coarse_grids_propagate_disparities_into_flat_regions() -> None:
    rng = np.random.default_rng(3)
    wall = np.full((90, 200), 128)
    wall[:, :30] = rng.integers(0, 256, (90, 30))
    wall[:, 160:] = rng.integers(0, 256, (90, 40))
    left, right = wall[:, :180].astype(np.uint8), wall[:, 9:189].astype(np.uint8)
    result = BeliefPropagationMatcher(MatchingConfig(num_disparities=32, iterations=5)).match(left, right)
    # 65 px from the texture on either side, 5 iterations per grid: no message travels that far on the finest one alone.
    assert np.mean(result.disparity_px[:, 9:] == 9) > 0.99


def test_iterations_are_those_of_the_finest_grid() -> None:
    rng = np.random.default_rng(4)
    left, right = rng.integers(0, 256, (2, 30, 70)).astype(np.uint8)
    for iterations, expected in ((3, 3), (0, belief_propagation.ITERATIONS)):
        matcher = BeliefPropagationMatcher(MatchingConfig(num_disparities=32, iterations=iterations))
        matcher.match(left, right)
        assert len(matcher.energies) == expected

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Expansion moves against exhaustive search, and the decrease of the energy."""

from __future__ import annotations

import itertools
import sys

import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.global_methods.energy import StereoModel, energy
from stereo_depth_ros.matching.global_methods.graph_cut import GraphCutMatcher


@pytest.fixture(autouse=True)
def _needs_maxflow(request: pytest.FixtureRequest) -> None:
    if "without_maxflow" not in request.node.name:
        pytest.importorskip("maxflow")


def random_model(seed: int, height: int = 3, width: int = 4, count: int = 5) -> StereoModel:
    rng = np.random.default_rng(seed)
    data = rng.integers(0, 100, (height, width, count)).astype(np.int32)
    weights = rng.integers(1, 20, (2, height, width)).astype(np.int32)
    weights[0, :, -1] = weights[1, -1] = 0
    return StereoModel(data, weights, 1 + seed % 3, 100)


@pytest.mark.parametrize("seed", range(6))
def test_expansion_is_the_best_of_all_choices(seed: int) -> None:
    model = random_model(seed, 3, 3)
    labels = np.random.default_rng(100 + seed).integers(0, 5, (3, 3)).astype(np.int32)
    alpha = seed % 5
    expanded = GraphCutMatcher(MatchingConfig())._expand(model, labels, alpha)
    assert ((expanded == labels) | (expanded == alpha)).all()
    choices = (np.reshape(choice, (3, 3)) for choice in itertools.product((False, True), repeat=9))
    assert energy(model, expanded) == min(energy(model, np.where(c, alpha, labels).astype(np.int32)) for c in choices)


@pytest.mark.parametrize("seed", range(6))
def test_energy_decreases_until_no_move_lowers_it(seed: int) -> None:
    model = random_model(seed, 7, 5)
    matcher = GraphCutMatcher(MatchingConfig(iterations=50))
    labels = matcher._label(model)
    assert matcher.energies[0] == energy(model, model.data.argmin(axis=2).astype(np.int32))
    assert matcher.energies[-1] == energy(model, labels)
    assert len(matcher.energies) > 3 and (np.diff(matcher.energies) < 0).all()
    for alpha in range(5):
        assert energy(model, matcher._expand(model, labels, alpha)) == matcher.energies[-1]


def test_iterations_are_cycles_through_the_disparities() -> None:
    rng = np.random.default_rng(8)
    left, right = rng.integers(0, 256, (2, 40, 70)).astype(np.uint8)
    energies = {}
    for cycles in (1, 2, 0):
        matcher = GraphCutMatcher(MatchingConfig(num_disparities=32, iterations=cycles))
        matcher.match(left, right)
        energies[cycles] = matcher.energies
    assert energies[2][: len(energies[1])] == energies[1] and len(energies[1]) <= 33
    assert energies[1][-1] > energies[2][-1] >= energies[0][-1]


def test_missing_maxflow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "maxflow", None)
    with pytest.raises(ConfigError, match=r"graph_cut needs PyMaxflow.*pip install PyMaxflow"):
        create_matcher("graph_cut")

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Registry of the matchers: consistent entries, one entry per new matcher, and the support of the matching costs."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.config import CONFIGS, MatchingConfig, matchers, parameter_infos
from stereo_depth_ros.core.types import U8, MatchResult
from stereo_depth_ros.matching import MATCHERS, create_matcher, onnx, registry
from stereo_depth_ros.matching.costs.census import census_rows, cost_rows
from stereo_depth_ros.matching.serial import SerialMatcher
from stereo_depth_ros.matching.sgm.semi_global_matching import SemiGlobalMatcher
from stereo_depth_ros.matching.window import fixed_window

NODE = SimpleNamespace(type="tensor(float)", shape=[1, 1, None, None])


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> None:
    """The matcher onnx without a file: a session with two inputs and one output."""
    inputs = [SimpleNamespace(name=name, **vars(NODE)) for name in ("left", "right")]
    session = SimpleNamespace(get_inputs=lambda: inputs, get_outputs=lambda: [SimpleNamespace(name="disparity")])
    monkeypatch.setattr(onnx, "_open", lambda model: session)


@pytest.mark.parametrize("name", MATCHERS)
def test_entries_are_consistent(name: str, network: None) -> None:
    matcher = create_matcher(name, correlation_window_size=7)
    assert matcher.name == name
    assert set(MATCHERS[name].parameters) <= {info.name for info in parameter_infos(MatchingConfig)}
    assert MATCHERS[name].sentence.endswith(".")
    assert bool(MATCHERS[name].uniqueness) == ("uniqueness_ratio" in MATCHERS[name].parameters)
    assert all(side % 2 == 1 and side > 0 for side in matcher.support_px)
    assert "support_px" in (type(matcher).__doc__ or "")


@pytest.mark.parametrize(
    ("name", "fields", "expected"),
    [
        ("bm", {}, (9, 9)),
        ("sgbm", {}, (11, 9)),
        ("sgm", {}, (11, 9)),
        ("window", {}, (7, 7)),
        ("window", {"vertical_search": 3}, (7, 13)),
        ("adaptive_window", {"vertical_search": 3}, (7, 13)),
        ("diffusion", {}, (7, 7)),
        ("scanline", {}, (7, 7)),
        ("graph_cut", {}, (7, 7)),
        ("belief_propagation", {"correlation_window_size": 1}, (3, 1)),
        ("features", {}, (15, 15)),
        ("onnx", {}, (1, 1)),
    ],
)
def test_support(name: str, fields: dict[str, int], expected: tuple[int, int], network: None) -> None:
    assert create_matcher(name, **{"correlation_window_size": 7, **fields}).support_px == expected


def census_costs(left: U8, right: U8) -> np.ndarray:
    """uint8 (H, W, K): the costs of the matcher sgm for disparities 15..0."""
    height, width = left.shape
    codes = np.empty((2, height, width), np.uint64)
    census_rows(0, height, left, codes[0])
    census_rows(0, height, right, codes[1])
    costs = np.empty((height, width, 16), np.uint8)
    scratch = np.empty((width + 2, 16), np.uint8), np.empty((3, width, 16), np.uint8)
    cost_rows(codes[0], codes[1], 0, height, 15, *scratch, costs)
    return costs


def window_costs(name: str, **fields: Any) -> Any:
    """Disparities (H, W), as a function of the images, without filters or checks over neighbors."""

    def disparities(left: U8, right: U8) -> np.ndarray:
        checks = {"speckle_size": 0, "uniqueness_ratio": 0.0, "texture_threshold": 0}
        matcher = create_matcher(name, num_disparities=32, correlation_window_size=5, **checks, **fields)
        return np.nan_to_num(matcher.match(left, right).disparity_px, nan=-1)

    return disparities


@pytest.mark.parametrize(
    ("function", "support_px"),
    [
        (window_costs("bm"), create_matcher("bm", correlation_window_size=5).support_px),
        (window_costs("window"), create_matcher("window", correlation_window_size=5).support_px),
        (census_costs, SemiGlobalMatcher.support_px),
    ],
    ids=["bm", "window", "sgm"],
)
def test_costs_depend_on_the_whole_support_and_nothing_else(
    function: Any, support_px: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """New noise in the left image outside the support of a pixel changes nothing there; on its border, it does."""
    monkeypatch.setattr(fixed_window, "median_filter", lambda disparity_x16, reasons, size: disparity_x16)
    rng = np.random.default_rng(11)
    left, right, other = rng.integers(0, 256, (3, 40, 90), dtype=np.uint8)
    y, x = 20, 60
    inside = np.zeros(left.shape, bool)
    inside[y - support_px[1] // 2 : y + support_px[1] // 2 + 1, x - support_px[0] // 2 : x + support_px[0] // 2 + 1] = 1
    expected = function(left, right)[y, x]
    np.testing.assert_array_equal(function(np.where(inside, left, other), right)[y, x], expected)
    columns, rows = inside.any(axis=0), inside.any(axis=1)
    for edge in (
        inside & (np.arange(90) == np.flatnonzero(columns)[0]),
        inside & (np.arange(90) == np.flatnonzero(columns)[-1]),
        inside & (np.arange(40) == np.flatnonzero(rows)[0])[:, None],
        inside & (np.arange(40) == np.flatnonzero(rows)[-1])[:, None],
    ):
        changed = [
            function(np.where(edge, rng.integers(0, 256, left.shape, dtype=np.uint8), left), right)[y, x]
            for _ in range(40)
        ]
        assert any((found != expected).any() for found in changed)


class ConstantMatcher(SerialMatcher):
    """Disparity 5 everywhere."""

    name = "constant"
    step_px = 1.0

    def _match(self, left: U8, right: U8) -> MatchResult:
        return MatchResult(np.full(left.shape, 5, np.float32), np.zeros(left.shape, np.uint8), self.step_px)


def test_a_new_matcher_is_one_module_and_one_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("stereo_depth_ros.matching.constant")
    module.ConstantMatcher = ConstantMatcher  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    entry = matchers.MatcherInfo("constant", "constant:ConstantMatcher", "Constant.", ("min_disparity", "iterations"))
    monkeypatch.setitem(matchers.MATCHERS, "constant", entry)  # type: ignore[arg-type]
    number = len(MATCHERS) - 1

    matching = sys.modules["stereo_depth_ros.config.matching"]
    try:
        config_class = importlib.reload(matching).MatchingConfig
        infos = {info.name: info for info in parameter_infos(config_class)}
        assert infos["stereo_algorithm"].doc.endswith(f"{number} constant.")
        assert infos["stereo_algorithm"].range_text == f"0 to {number}"
        assert infos["iterations"].doc.endswith("For diffusion, graph_cut, belief_propagation, constant.")
        assert "constant" in infos["speckle_size"].doc  # "For all but ..., constant."
        for name in ("constant", number):
            matcher = registry.create_matcher(name, config_class())
            assert (matcher.name, matcher.config.stereo_algorithm) == ("constant", number)
            assert (matcher.match(np.zeros((4, 6), np.uint8), np.zeros((4, 6), np.uint8)).disparity_px == 5).all()
    finally:
        monkeypatch.undo()
        matching.MatchingConfig = CONFIGS["matching"]  # type: ignore[attr-defined]
        registry._matcher_class.cache_clear()

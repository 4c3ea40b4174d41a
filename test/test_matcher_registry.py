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

from stereo_depth_ros.config import CONFIGS, MatchingConfig, PipelineConfig, matchers, parameter_infos
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import U8, MatchResult
from stereo_depth_ros.matching import MATCHERS, create_matcher, onnx, registry
from stereo_depth_ros.matching.costs.census import CENSUS_PLANES, MARGIN, census_rows, empty_census
from stereo_depth_ros.matching.networks.network import Network
from stereo_depth_ros.matching.serial import SerialMatcher
from stereo_depth_ros.matching.sgm.semi_global_matching import SemiGlobalMatcher
from stereo_depth_ros.matching.window import fixed_window

NODE = SimpleNamespace(type="tensor(float)", shape=[1, 1, None, None])


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> None:
    """The matcher onnx without a file: a session with two inputs and one output."""
    inputs = [SimpleNamespace(name=name, **vars(NODE)) for name in ("left", "right")]
    outputs = [SimpleNamespace(name="disparity", **vars(NODE))]
    session = SimpleNamespace(get_inputs=lambda: inputs, get_outputs=lambda: outputs)
    monkeypatch.setattr(onnx, "open_network", lambda model, provider, matcher: Network(model, session, "cpu", {}))


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
        ("bm", {}, (7, 7)),
        ("sgbm", {}, (7, 7)),
        ("sgm", {}, (7, 5)),
        ("window", {}, (7, 7)),
        ("window", {"vertical_search": 3}, (7, 7)),
        ("adaptive_window", {"vertical_search": 3}, (7, 7)),
        ("diffusion", {}, (7, 7)),
        ("scanline", {}, (7, 7)),
        ("graph_cut", {}, (7, 7)),
        ("belief_propagation", {"correlation_window_size": 1}, (1, 1)),
        ("features", {}, (15, 15)),
        ("onnx", {}, (1, 1)),
        ("spacetime", {"spacetime_window": 3}, (3, 3)),
    ],
)
def test_support(name: str, fields: dict[str, int], expected: tuple[int, int], network: None) -> None:
    assert create_matcher(name, **{"correlation_window_size": 7, **fields}).support_px == expected


def left_census(left: U8, right: U8) -> np.ndarray:
    """uint32 (H, W): the descriptors that the costs of the matcher sgm compare."""
    codes = empty_census(*left.shape)
    census_rows(0, left.shape[0], left, codes)
    inside = np.ascontiguousarray(codes[:, :CENSUS_PLANES, MARGIN:-MARGIN].transpose(0, 2, 1))
    return inside.view(np.uint32)[..., 0]


def window_disparities(left: U8, right: U8) -> np.ndarray:
    """Disparities (H, W) of the matcher window, without checks over neighbors."""
    checks = {"speckle_size": 0, "uniqueness_ratio": 0.0}
    matcher = create_matcher("window", num_disparities=32, correlation_window_size=5, **checks)
    return np.nan_to_num(matcher.match(left, right).disparity_px, nan=-1)


@pytest.mark.parametrize(
    ("function", "support_px"),
    [
        (window_disparities, create_matcher("window", correlation_window_size=5).support_px),
        (left_census, SemiGlobalMatcher.support_px),
    ],
    ids=["window", "sgm"],
)
def test_costs_depend_on_the_whole_support_and_nothing_else(
    function: Any, support_px: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """New noise in the left image outside the support of a pixel changes nothing there; on its border, it does."""
    monkeypatch.setattr(fixed_window, "median_filter", lambda disparity_x16, reasons, size: disparity_x16)
    rng = np.random.default_rng(11)
    left, right, other = rng.integers(0, 256, (3, 40, 90), dtype=np.uint8)
    y, x = 20, 60
    rows, columns = (
        slice(at - size // 2, at + size // 2 + 1) for at, size in zip((y, x), support_px[::-1], strict=True)
    )
    changed = other.copy()
    changed[rows, columns] = left[rows, columns]
    expected = function(left, right)[y, x]
    assert function(changed, right)[y, x] == expected
    for edge in (
        np.s_[rows.start, columns],
        np.s_[rows.stop - 1, columns],
        np.s_[rows, columns.start],
        np.s_[rows, columns.stop - 1],
    ):
        found = []
        for _ in range(40):
            changed = left.copy()
            changed[edge] = rng.integers(0, 256, changed[edge].shape)
            found.append(function(changed, right)[y, x])
        assert any(value != expected for value in found), edge


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


@pytest.mark.parametrize("config", [PipelineConfig(), {}, {"P1": 3.0}])
def test_a_config_of_another_type_is_refused(config: Any) -> None:
    with pytest.raises(ConfigError, match=r"config is (PipelineConfig|dict), a matcher takes MatchingConfig: pass"):
        create_matcher("sgbm", config)

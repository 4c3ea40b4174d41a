# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmarks compute their tables correctly, and sgm has the required accuracy relative to OpenCV."""

from __future__ import annotations

import importlib
import importlib.util
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig

PROGRAMS = Path(__file__).resolve().parents[1] / "benchmarks"
PROGRAM = PROGRAMS / "matching.py"


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    spec = importlib.util.spec_from_file_location("matching_benchmark", PROGRAM)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def accuracy_rows(benchmark: ModuleType, scene: str, sgm: dict[str, float], dense: float) -> list[dict[str, Any]]:
    """Rows of a scene in which every other method has density 0.8, 20 in all other figures and 30 in bad_2_all."""
    figures = dict.fromkeys(benchmark.FIGURES, 20.0) | {"density": 0.8, "bad_2_all": 30.0, "ms": 10.0}
    changes = {"sgm": sgm, "sgm dense": {"density": 1.0, "bad_2_all": dense}}
    return [{"scene": scene, "method": name} | figures | changes.get(name, {}) for name in benchmark.COMPARED]


def test_requirements_are_ratios_of_means(benchmark: ModuleType) -> None:
    rows = accuracy_rows(benchmark, "cones", {"density": 0.85, "bad_2": 6.0, "bad_1": 12.0}, dense=6.0)
    rows += accuracy_rows(benchmark, "tsukuba", {"density": 0.82, "bad_2": 14.0, "bad_1": 10.0}, dense=12.0)
    both, tuned, held_out = benchmark.requirements(rows)
    assert (both["scenes"], tuned["scenes"], held_out["scenes"]) == ("all (2)", "tuned on (1)", "held out (1)")
    assert both["bad_2 ratio"] == pytest.approx((6 + 14) / (20 + 20))
    assert both["bad_1 ratio"] == pytest.approx((12 + 10) / (20 + 20))
    assert both["density points"] == pytest.approx(3.5)
    assert both["dense bad_2_all ratio"] == pytest.approx((6 + 12) / (30 + 30))
    assert both["misses"] == tuned["misses"] == "nothing"
    assert held_out["misses"] == "bad_2 ratio, density points, dense bad_2_all ratio"


def test_disparity_x16_becomes_pixels(benchmark: ModuleType) -> None:
    # OpenCV marks invalid pixels by -80 if the minimum disparity is -4
    disparity_x16 = np.array([[-80, -64, -63, 0, 24]], np.int16)
    found = benchmark.disparities(lambda left, right: disparity_x16, None, None, MatchingConfig(min_disparity=-4))
    np.testing.assert_array_equal(found, np.array([[np.nan, -4, -63 / 16, 0, 1.5]], np.float32))


def test_timed_calls_alternate_after_warming_up(benchmark: ModuleType) -> None:
    order: list[str] = []
    calls = {name: lambda left, right, name=name: order.append(name) for name in ("a", "b")}
    times = benchmark.timed_ms(calls, None, None, 3)
    assert "".join(order) == "abababab"
    assert {name: len(values) for name, values in times.items()} == {"a": 3, "b": 3}


@pytest.mark.real_data
def test_sgm_compared_with_sgbm(benchmark: ModuleType, stereo_data: Path) -> None:
    scenes = benchmark.load_scenes(stereo_data, [])
    assert len(scenes) == 12
    everything = benchmark.requirements(benchmark.accuracy(scenes, rounds=0))[0]
    assert everything["misses"] == "nothing", everything


@pytest.fixture
def injection(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The program, which sets variables for its processes."""
    pytest.importorskip("rclpy", reason="the faults are those of a graph")
    monkeypatch.setattr(os, "environ", {**os.environ, "STEREO_DEPTH_MALLOPT": "0"})
    monkeypatch.syspath_prepend(PROGRAMS)
    return importlib.import_module("fault_injection")


def test_values_that_may_have_been_in_use(injection: ModuleType) -> None:
    history = injection.History("a")
    history.change("b", requested=10.0, answered=12.0)
    history.change("c", requested=20.0, answered=21.0)
    assert history.current == "c"
    assert history.between(5.0, 9.0) == ["a"]
    assert history.between(9.0, 11.0) == ["b", "a"]
    assert history.between(13.0, 14.0) == ["b"]
    assert history.between(11.0, 30.0) == ["c", "b", "a"]


def test_faults_come_all_and_in_changing_order(injection: ModuleType) -> None:
    names = list(injection.faults(injection.random.Random(1), 14))
    assert names[0] == "start"
    assert set(names[1:8]) == set(names[8:]) == set(injection.FAULTS) - {"start"}
    assert names[1:8] != names[8:]


def test_output_is_that_of_its_own_pair_only(injection: ModuleType) -> None:
    """Another frame, encoding, calibration or parameter gives other bytes."""
    offline, base = injection.Offline(), injection.BASE
    stamp_ns = 5_000_001_000  # of the first source and frame
    right = offline.message("points2", stamp_ns, base)
    others = [offline.message("points2", stamp_ns + key, base) for key in (1, injection.FRAMES, 3 * injection.FRAMES)]
    changed = injection.dataclasses.replace(base.matching, uniqueness_ratio=60.0)
    others.append(offline.message("points2", stamp_ns, injection.dataclasses.replace(base, matching=changed)))
    contents = {message[12:] for message in (right, *others)}  # after the stamp
    assert len(contents) == 5

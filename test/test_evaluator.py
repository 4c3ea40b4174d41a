# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The evaluator: search range, timing, and every figure by hand."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from evaluation_scenes import NEAR_PX, pair

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.evaluation import evaluator
from stereo_depth_ros.evaluation.evaluator import evaluate, search_range
from stereo_depth_ros.evaluation.scenes import Scene, make_scene

NAN = np.nan
TRUTH = np.array([[10, 20, 30, 40, 50], [12, 22, 32, NAN, 52]], np.float32)
# errors 0, 0.25, 0.75, 3, 6; 0, 1.5, a hole, no truth, a hole
FOUND = np.array([[10, 20.25, 30.75, 43, 56], [12, 23.5, NAN, 5, NAN]], np.float32)
CONFIDENCE = np.array([[0.9, 0.8, 0.7, 0.2, 0.3], [0.9, 0.6, 0, 1, 0]], np.float32)
VISIBLE = np.array([[1, 1, 1, 0, 0], [1, 1, 1, 1, 0]], np.bool_)
OBJECT = np.array([[0, 0, 0, 0, 1], [0, 0, 0, 0, 1]], np.bool_)


class StubMatcher:
    """Returns the same disparities for every pair."""

    name, step_px = "stub", 1 / 16

    def __init__(self, config: MatchingConfig, found: F32 = FOUND, seconds: tuple[float, ...] = ()) -> None:
        self.config, self.calls = config, 0
        self._found, self._seconds = found, seconds

    def match(self, left: U8, right: U8, out: F32 | None = None, earlier: Any = ()) -> MatchResult:
        time.sleep(self._seconds[self.calls] if self._seconds else 0)
        self.calls += 1
        reasons = np.where(np.isfinite(self._found), 0, int(Reason.NO_MATCH)).astype(np.uint8)
        return MatchResult(self._found, reasons, self.step_px, CONFIDENCE if self._found is FOUND else None)


@pytest.fixture
def scene() -> Scene:
    gray = np.zeros(TRUTH.shape, np.uint8)
    return make_scene(gray, gray, TRUTH, VISIBLE, OBJECT)


def use(monkeypatch: pytest.MonkeyPatch, **how: object) -> list[StubMatcher]:
    made: list[StubMatcher] = []

    def create(name: str, config: MatchingConfig) -> StubMatcher:
        made.append(StubMatcher(config, **how))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setattr(evaluator, "create_matcher", create)
    return made


def test_figures_by_hand(monkeypatch: pytest.MonkeyPatch, scene: Scene) -> None:
    use(monkeypatch)
    row = evaluate("room", scene, "stub", MatchingConfig(), ["min_disparity"]).to_json()
    assert list(row)[:9] == ["scene", "matcher", "density", "bad_0_5", "bad_1", "bad_2", "bad_2_all", "avg", "ms"]
    expected = {
        "density": 7 / 9,
        "bad_0_5": 100 * 4 / 7,
        "bad_1": 100 * 3 / 7,
        "bad_2": 100 * 2 / 7,
        "bad_4": 100 * 1 / 7,
        "bad_2_all": 100 * 4 / 9,
        "avg": 11.5 / 7,
        "rms": math.sqrt((0.0625 + 0.5625 + 9 + 36 + 2.25) / 7),
        "a50": 0.75,
        "a90": 3 + 0.4 * 3,  # of 0, 0, 0.25, 0.75, 1.5, 3, 6: 0.9 x 6 = 5.4 steps after the first
        "d1": 100 * 1 / 7,  # 6 px of 50; 3 px are not above 3
        "d1_all": 100 * 3 / 9,
        "d1_bg": 0,
        "d1_bg_all": 100 * 1 / 7,
        "d1_fg": 100,
        "d1_fg_all": 100,
        "nonocc_density": 5 / 6,
        "nonocc_bad_1": 100 * 1 / 5,
        "nonocc_bad_2_all": 100 * 1 / 6,
        "nonocc_avg": 2.5 / 5,
        "edges_share": 1,  # all neighbors in a row differ by 10 px
        "edges_density": 7 / 9,
        "edges_bad_2": 100 * 2 / 7,
        "edges_bad_2_all": 100 * 4 / 9,
        "edges_avg": 11.5 / 7,
        "thin_share": 0,  # disparities rise to the border, beyond which surfaces go on
        # by confidence right, right, right, right, then wrong 1.5, 6 and 3
        "auc_bad_1": 100 * (1 / 5 + 2 / 6 + 3 / 7) / 7,
        "auc_bad_1_random": 100 * 3 / 7,
        "auc_bad_1_oracle": 100 * (1 / 5 + 2 / 6 + 3 / 7) / 7,
        "auc_bad_1_ratio": (1 / 5 + 2 / 6 + 3 / 7) / 3,
        "auc_avg": (0 + 0 + 0.25 / 3 + 1 / 4 + 2.5 / 5 + 8.5 / 6 + 11.5 / 7) / 7,
        "auc_avg_oracle": (0 + 0 + 0.25 / 3 + 1 / 4 + 2.5 / 5 + 5.5 / 6 + 11.5 / 7) / 7,
    }
    assert {name: row[name] for name in expected} == pytest.approx(expected)
    assert (row["scene"], row["matcher"], row["occlusion"], row["width"], row["height"]) == (
        "room",
        "stub",
        "mask",
        5,
        2,
    )
    assert row["thin_density"] is None and row["thin_bad_2"] is None
    assert row["parameters"] == {}  # 52 px are searched by the default of 64
    assert row["curve"]["kept"][-1] == 1 and row["curve"]["coverage"][-1] == pytest.approx(7 / 9)
    assert row["curve"]["bad_1"][-1] == pytest.approx(100 * 3 / 7) and row["curve"]["bad_1"][9] == 0
    assert row["curve"]["avg"][-1] == pytest.approx(11.5 / 7)


def test_figures_over_no_pixels_are_none(monkeypatch: pytest.MonkeyPatch, scene: Scene) -> None:
    use(monkeypatch, found=np.full_like(FOUND, NAN))
    row = evaluate("room", scene, "stub", MatchingConfig()).to_json()
    assert (row["density"], row["bad_2_all"], row["d1_all"]) == (0, 100, 100)
    assert [row[name] for name in ("bad_2", "avg", "a99", "auc_bad_1", "auc_bad_1_ratio", "curve")] == [None] * 6


def test_time_is_the_median_without_the_first_call(monkeypatch: pytest.MonkeyPatch, scene: Scene) -> None:
    made = use(monkeypatch, seconds=(0.2, 0.01, 0.01, 0.2, 0.03, 0.2))
    evaluation = evaluate("room", scene, "stub", MatchingConfig())
    assert (made[0].calls, evaluation.runs) == (6, 5)
    assert 30 <= evaluation.ms < 80  # the mean of the five is 90; sleep is never shorter, but longer on a busy machine
    assert evaluation.ms_per_megapixel == pytest.approx(evaluation.ms / 10e-6)
    assert evaluation.ms_per_million_disparities == pytest.approx(evaluation.ms / (10e-6 * 64))


def test_slow_methods_are_timed_less_often(monkeypatch: pytest.MonkeyPatch, scene: Scene) -> None:
    monkeypatch.setattr(evaluator, "_ENOUGH_S", 0.05)
    made = use(monkeypatch, seconds=(0.03, 0.03, 0.03, 0.03))
    assert evaluate("room", scene, "stub", MatchingConfig()).runs == 2
    assert made[0].calls == 3


@pytest.mark.parametrize(
    ("low", "high", "begins", "count"),
    [
        (1, 3, 0, 32),
        (0, 31.9, 0, 32),
        (0, 32, 0, 48),
        (2, 63.5, 0, 64),
        (5, 64, 0, 80),
        (-5.5, 20, -6, 32),
        (-9, -3, -9, 32),
    ],
)
def test_search_ends_above_the_largest_true_disparity(low: float, high: float, begins: int, count: int) -> None:
    config = search_range(MatchingConfig(), np.array([[high, NAN, low, np.inf]], np.float32))
    assert (config.min_disparity, config.num_disparities) == (begins, count)


def test_given_parameters_are_kept() -> None:
    truth = np.array([[-8, 100]], np.float32)
    given = MatchingConfig(min_disparity=-3, num_disparities=48)
    kept = search_range(given, truth, ["disparity_range", "min_disparity"])
    assert (kept.min_disparity, kept.num_disparities) == (-3, 48)
    kept = search_range(given, truth, ["min_disparity"])
    assert (kept.min_disparity, kept.num_disparities) == (-3, 112)  # -3 + 112 = 109 is above 100, 93 is not
    kept = search_range(given, truth, ["disparity_range"])
    assert (kept.min_disparity, kept.num_disparities) == (-8, 48)


def test_refusals(monkeypatch: pytest.MonkeyPatch, scene: Scene) -> None:
    with pytest.raises(ConfigError, match="unknown matcher 'best'"):
        evaluate("room", scene, "best", MatchingConfig())
    with pytest.raises(ImageError, match="5 x 2 px"):
        evaluate("room", scene, "bm", MatchingConfig())
    use(monkeypatch, found=FOUND[:1])
    with pytest.raises(ImageError, match=r"stub returns \(1, 5\), the image is \(2, 5\)"):
        evaluate("room", scene, "stub", MatchingConfig())


@pytest.mark.parametrize("matcher", ["bm", "sgbm"])
def test_real_methods_on_a_scene_of_whole_disparities(matcher: str) -> None:
    evaluation = evaluate("planes", make_scene(*pair()), matcher, MatchingConfig(correlation_window_size=9))
    assert evaluation.config.num_disparities == 32 and NEAR_PX < 32
    # The 32 px at the left are not searched; windows across the edges of the near rectangle may be wrong.
    assert 0.65 < evaluation.errors.density < 0.85
    assert evaluation.errors.median_px <= 1 / 16 and evaluation.errors.bad_1 < 6
    assert evaluation.nonocc.bad_1 < evaluation.errors.bad_1
    ratio = evaluation.figures()["auc_bad_1_ratio"]
    assert isinstance(ratio, float) and 0 < ratio < 0.5

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reports of runs and the pair tracker: counts, percentiles, stage timings, JSON."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from stereo_depth_ros.nodes.replay.tracker import PairTracker
from stereo_depth_ros.offline.report import OutputStats, RunReport, percentile, stage_timings


def report_of(**changes: object) -> RunReport:
    values: dict[str, object] = {
        "bag": Path("in.mcap"),
        "output": None,
        "pairs": 3,
        "unpaired_left": 1,
        "unpaired_right": 0,
        "outputs": {"disparity": OutputStats(2, 1, (10.0, 30.0)), "points2": OutputStats(3, 0, (1.0, 2.0, 4.0))},
        "wall_s": 1.5,
    }
    return RunReport(**{**values, **changes})  # type: ignore[arg-type]


def test_percentile_interpolates_between_the_two_nearest_values() -> None:
    assert percentile([40.0, 10.0, 20.0], 50) == 20.0
    assert percentile([10.0, 20.0], 95) == pytest.approx(19.5)  # 10 + 0.95 * 10
    assert math.isnan(percentile([], 50))


def test_report_counts_losses_over_all_outputs_and_pairs_per_second() -> None:
    report = report_of()
    assert report.lost == 1
    assert report.frames_per_second == 2.0
    assert report.outputs["disparity"].p50_ms == 20.0
    assert math.isnan(report_of(wall_s=0.0).frames_per_second)


def test_json_holds_plain_values_and_null_for_nan() -> None:
    report = report_of(wall_s=0.0, outputs={"disparity": OutputStats(0, 3)}, stages_ms={"match": (8.0, 9.0)})
    values = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert values["bag"] == "in.mcap"
    assert values["outputs"] == {"disparity": {"received": 0, "lost": 3, "p50_ms": None, "p95_ms": None}}
    assert values["frames_per_second"] is None
    assert values["stages_ms"] == {"match": {"p50_ms": 8.0, "p95_ms": 9.0}}


def test_stage_timings_are_the_pairs_of_percentiles_among_the_values() -> None:
    values = {"paired": "12", "match p50 ms": "8.5", "match p95 ms": "9.25", "lonely p50 ms": "1"}
    assert stage_timings(values) == {"match": (8.5, 9.25)}


def test_tracker_counts_each_output_of_a_pair_once() -> None:
    tracker = PairTracker(["disparity", "points2"])
    tracker.sent(1_000, 1_000, now_ns=5_000_000)
    assert tracker.received("disparity", 1_000, now_ns=7_500_000)
    assert not tracker.received("disparity", 1_000, now_ns=8_000_000), "a duplicate"
    assert not tracker.received("points2", 999, now_ns=8_000_000), "of no pair that was sent"
    assert tracker.pending == 1
    assert tracker.received("points2", 1_000, now_ns=9_000_000)
    assert tracker.pending == 0
    assert tracker.stats() == {"disparity": OutputStats(1, 0, (2.5,)), "points2": OutputStats(1, 0, (4.0,))}


def test_tracker_recognizes_a_pair_by_the_stamp_of_either_camera() -> None:
    tracker = PairTracker(["disparity", "right/image_rect"])
    tracker.sent(1_000, 1_200, now_ns=0)
    assert tracker.pending == 1
    assert tracker.received("right/image_rect", 1_200, now_ns=10)
    assert tracker.received("disparity", 1_000, now_ns=10)
    assert tracker.pending == 0


def test_latency_of_a_pair_that_is_sent_again_counts_from_the_last_sending() -> None:
    tracker = PairTracker(["disparity", "points2"])
    tracker.sent(1_000, 1_000, now_ns=0)
    tracker.sent_again(1_000, now_ns=8_000_000)
    tracker.received("disparity", 1_000, now_ns=9_500_000)
    assert tracker.stats()["disparity"].latencies_ms == (1.5,)
    assert [pair.topics for pair in tracker.give_up(sent_before_ns=1)] == [("points2",)], "sent first at 0"


def test_tracker_gives_up_overdue_pairs_and_reports_the_missing_outputs() -> None:
    tracker = PairTracker(["disparity", "points2"])
    tracker.sent(1_000, 1_000, now_ns=100)
    tracker.sent(2_000, 2_000, now_ns=200)
    tracker.sent(3_000, 3_000, now_ns=300)
    tracker.received("points2", 1_000, now_ns=150)
    lost = tracker.give_up(sent_before_ns=300)
    assert [(pair.stamp_ns, pair.topics, pair.without_output) for pair in lost] == [
        (1_000, ("disparity",), False),
        (2_000, ("disparity", "points2"), True),
    ]
    assert tracker.pending == 1
    assert not tracker.received("disparity", 1_000, now_ns=400), "too late"
    assert {topic: stats.lost for topic, stats in tracker.stats().items()} == {"disparity": 2, "points2": 1}


def test_the_rate_of_an_offline_run_does_not_count_its_warm_up() -> None:
    report = report_of(wall_s=12.0, warm_up_s=10.0, pairs=5)
    assert report.frames_per_second == 2.0
    assert report_of(wall_s=4.0, warm_up_s=4.0, pairs=1).frames_per_second == 0.25

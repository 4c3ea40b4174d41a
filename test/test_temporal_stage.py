# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs matched together with those before them: in order, in threads, from a bag, and where a stream begins anew."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stereo_bags import messages_of, sequence, write_truth_bag

from stereo_depth_ros import PipelineConfig, StereoPipeline, StereoResult
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.overlap import Overlap
from stereo_depth_ros.core.types import F32, StereoPair
from stereo_depth_ros.evaluation.bag_scenes import BagScenes
from stereo_depth_ros.evaluation.evaluator import evaluate
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.pipeline import PreparedPair

FRAMES, TOGETHER = 5, 3
SEQUENCE = sequence(FRAMES)
FIELDS = {"num_disparities": 32, "spacetime_window": 5, "temporal_window": TOGETHER}
NAMES = ["spacetime", "sgm"]
DISPARITY = "stereo_msgs/msg/DisparityImage"


def config_of(name: str, **fields: object) -> PipelineConfig:
    return PipelineConfig(matching=create_matcher(name, **{**FIELDS, **fields}).config)


def expected_of(name: str, before: int, number: int) -> F32:
    """Disparities of a pair matched together with up to ``before`` pairs, by the matcher alone."""
    pipeline = StereoPipeline(config_of(name), SEQUENCE.rig)
    rectified = [pipeline.prepare(frame.pair).rectified for frame in SEQUENCE]
    images = [(pair.left, pair.right) for pair in rectified]
    earlier = images[max(number - before, 0) : number]
    stage = StereoPipeline(config_of(name), SEQUENCE.rig)._disparity
    return stage.match(*images[number], earlier=earlier).disparity_px


@pytest.mark.parametrize("name", NAMES)
def test_a_pair_is_matched_with_those_before_it(name: str) -> None:
    pipeline = StereoPipeline(config_of(name), SEQUENCE.rig)
    results = [pipeline.process(frame.pair).disparity.disparity_px for frame in SEQUENCE]
    for number, found in enumerate(results):
        np.testing.assert_array_equal(found, expected_of(name, TOGETHER - 1, number))
    assert not np.array_equal(results[4], expected_of(name, 1, 4), equal_nan=True)
    assert not np.array_equal(results[4], expected_of(name, 3, 3), equal_nan=True)


def test_more_pairs_than_the_matcher_takes_are_ignored_and_single_pairs_do_not_depend_on_history() -> None:
    images = [(frame.pair.left.pixels, frame.pair.right.pixels) for frame in SEQUENCE]
    matcher, single = create_matcher("spacetime", **FIELDS), create_matcher("sgm", num_disparities=32)
    assert (matcher.pair_count, single.pair_count) == (3, 1)
    assert create_matcher("spacetime").pair_count == 8
    expected = matcher.match(*images[4], earlier=images[2:4]).disparity_px
    np.testing.assert_array_equal(matcher.match(*images[4], earlier=images[:4]).disparity_px, expected)
    alone = create_matcher("spacetime", **FIELDS).match(*images[4]).disparity_px
    np.testing.assert_array_equal(matcher.match(*images[4]).disparity_px, alone)
    np.testing.assert_array_equal(
        single.match(*images[4], earlier=images[:4]).disparity_px, single.match(*images[4]).disparity_px
    )


def test_earlier_pairs_of_another_size_are_refused() -> None:
    left, right = SEQUENCE[0].pair.left.pixels, SEQUENCE[0].pair.right.pixels
    with pytest.raises(ImageError, match=r"an earlier pair is \(\d+, \d+\), the newest is .*: match pairs of one size"):
        create_matcher("spacetime", **FIELDS).match(left, right, earlier=[(left[2:], right[2:])])


@pytest.mark.parametrize("gap", [0.0, 0.099])
def test_a_gap_a_new_beginning_and_changed_parameters_begin_anew(gap: float) -> None:
    pipeline = StereoPipeline(config_of("spacetime", temporal_gap=gap), SEQUENCE.rig)  # 10 pairs a second
    first, second = (pipeline.prepare(SEQUENCE[number].pair) for number in (0, 1))
    assert (len(first.earlier), len(second.earlier)) == (0, 0 if gap else 1)
    again = pipeline.prepare(SEQUENCE[0].pair)
    assert again.earlier == ()
    same = pipeline.with_config(replace(pipeline.config, depth=replace(pipeline.config.depth, depth_encoding="16UC1")))
    assert len(same.prepare(SEQUENCE[1].pair).earlier) == (0 if gap else 1)
    changed = pipeline.with_config(config_of("spacetime", temporal_gap=gap, speckle_size=7))
    assert changed.prepare(SEQUENCE[2].pair).earlier == ()


def test_overlapping_frames_give_what_one_after_the_other_gives() -> None:
    """Frames are prepared in order; which of those that wait is matched first does not matter."""
    pipeline = StereoPipeline(config_of("spacetime"), SEQUENCE.rig)
    results: list[StereoResult] = []

    def deliver(future: Future[StereoResult]) -> None:
        results.append(future.result())

    overlap: Overlap[StereoPair, PreparedPair, StereoResult]
    overlap = Overlap(pipeline.prepare, pipeline.match, deliver, lambda _: 3)
    overlap.begin_overlap()
    with ThreadPoolExecutor(5) as threads:
        for frame in SEQUENCE:
            overlap.add(frame.pair, 100)
        runs = [threads.submit(overlap.run_one) for _ in range(FRAMES)]
        assert all(run.result() for run in runs)
    for number, result in enumerate(results):
        np.testing.assert_array_equal(result.disparity.disparity_px, expected_of("spacetime", TOGETHER - 1, number))


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("temporal") / "in.mcap"
    write_truth_bag(path, FRAMES)
    return path


def test_a_bag_is_processed_and_evaluated_with_the_pairs_before(bag: Path, tmp_path: Path) -> None:
    values = {"stereo_algorithm": 11, "disparity_range": 32, "spacetime_window": 5, "temporal_window": TOGETHER}
    config = pipeline_config(values)
    process_bag(BagSelection(bag), tmp_path / "out.mcap", config)
    messages, types = messages_of(tmp_path / "out.mcap", "/disparity"), RosbagsTypes()
    sources = list(BagScenes(BagSelection(bag), TOGETHER, config.matching.temporal_gap_ns))
    for number in (0, 4):
        expected = expected_of("spacetime", TOGETHER - 1, number)
        found = matched_disparity(types.deserialize(messages[SEQUENCE.stamp_ns(number)], DISPARITY), SEQUENCE.rig)
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
        np.testing.assert_allclose(found, expected, atol=1e-4)
        scene = sources[number].load()
        assert len(scene.earlier) == min(number, TOGETHER - 1)
    evaluation = evaluate("", scene, "spacetime", config.matching, {"min_disparity", "disparity_range"})
    kept = np.isfinite(expected)  # of what the matcher returns, the stage rejects some
    np.testing.assert_array_equal(evaluation.result.disparity_px[kept], expected[kept])

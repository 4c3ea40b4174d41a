# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One matcher, stage or pipeline called from two threads gives what it gives to one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import cv2
import numpy as np
import pytest

from stereo_depth_ros import MatchingConfig, PipelineConfig, StereoPipeline
from stereo_depth_ros.core.types import U8, MatchResult, StereoPair
from stereo_depth_ros.matching import MATCHERS, create_matcher
from stereo_depth_ros.stages.disparity import DisparityStage
from stereo_depth_ros.stages.features import FeatureStage
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

THREADS = 2
SEQUENCE = SyntheticSequence(frames=2, width=160, height=120)
FRAMES = {"bm": 30, "sgbm": 30, "sgm": 30, "features": 30}  # of the others, which are slow, a few
ImagesT = TypeVar("ImagesT")


def textured_pair(seed: int) -> tuple[U8, U8]:
    """Smoothed noise whose upper and lower parts have different disparities."""
    rng = np.random.default_rng(seed)
    wide = cv2.GaussianBlur(rng.integers(0, 256, (120, 200), dtype=np.uint8), (0, 0), 1.0)
    upper, lower, seam = rng.integers(2, 14), rng.integers(14, 28), rng.integers(40, 80)
    right = np.vstack([wide[:seam, upper : upper + 160], wide[seam:, lower : lower + 160]])
    return np.ascontiguousarray(wide[:, :160]), right


def in_two_threads(work: Callable[[ImagesT], bytes], inputs: Sequence[ImagesT], frames: int) -> list[list[bytes]]:
    """What each thread got, frame by frame; thread t begins with input t and takes the inputs in turn."""
    start = threading.Barrier(THREADS)

    def run(thread: int) -> list[bytes]:
        start.wait(timeout=60)
        return [work(inputs[(thread + frame) % len(inputs)]) for frame in range(frames)]

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(run, range(THREADS)))


def assert_as_in_one_thread(
    make: Callable[[], Callable[[ImagesT], bytes]], inputs: Sequence[ImagesT], frames: int
) -> None:
    """``make`` makes the object to be called; the expected bytes are those of another one, in one thread."""
    alone = make()
    expected = [alone(images) for images in inputs]
    assert len(set(expected)) == len(inputs)
    for thread, found in enumerate(in_two_threads(make(), inputs, frames)):
        wrong = [f for f in range(frames) if found[f] != expected[(thread + f) % len(inputs)]]
        assert not wrong, f"thread {thread}: {len(wrong)} of {frames} frames are wrong"


def result_bytes(result: MatchResult) -> bytes:
    assert result.confidence is not None
    return result.disparity_px.tobytes() + result.reasons.tobytes() + result.confidence.tobytes()


@pytest.mark.parametrize("name", [name for name in MATCHERS if name != "onnx"])  # onnx: see test_onnx.py
def test_matchers(name: str) -> None:
    if name == "graph_cut":
        pytest.importorskip("maxflow")

    def make() -> Callable[[tuple[U8, U8]], bytes]:
        fields = {"num_disparities": 32, "correlation_window_size": 9, "speckle_size": 50, "iterations": 2}
        matcher = create_matcher(name, **fields)
        return lambda images: result_bytes(matcher.match(*images))

    assert_as_in_one_thread(make, [textured_pair(1), textured_pair(2)], FRAMES.get(name, 2))


@pytest.mark.parametrize("name", ["bm", "sgbm", "sgm"])
def test_the_pipeline_on_raw_pairs(name: str) -> None:
    config = PipelineConfig(matching=create_matcher(name, num_disparities=32).config)

    def make() -> Callable[[StereoPair], bytes]:
        pipeline = StereoPipeline(config, SEQUENCE.rig)

        def process(pair: StereoPair) -> bytes:
            result = pipeline.process(pair)
            return result_bytes(result.disparity) + result.depth_m.tobytes()

        return process

    assert_as_in_one_thread(make, [SEQUENCE[0].pair, SEQUENCE[1].pair], 30)


def rectified_pairs() -> list[tuple[U8, U8]]:
    rectifier = Rectifier(SEQUENCE.rig)
    pairs = [rectifier.rectify(SEQUENCE[number].pair) for number in range(2)]
    return [(pair.left, pair.right) for pair in pairs]


def test_the_disparity_stage() -> None:
    def make() -> Callable[[tuple[U8, U8]], bytes]:
        stage = DisparityStage(MatchingConfig(num_disparities=32), Rectifier(SEQUENCE.rig))
        return lambda images: result_bytes(stage.match(*images))

    assert_as_in_one_thread(make, rectified_pairs(), 30)


def test_the_feature_stage() -> None:
    def make() -> Callable[[tuple[U8, U8]], bytes]:
        stage = FeatureStage(MatchingConfig(num_disparities=32), Rectifier(SEQUENCE.rig))

        def find(images: tuple[U8, U8]) -> bytes:
            matches = stage.find(*images)
            return matches.left_xy.tobytes() + matches.right_xy.tobytes() + matches.score.tobytes()

        return find

    assert_as_in_one_thread(make, rectified_pairs(), 30)

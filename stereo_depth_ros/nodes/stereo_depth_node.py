# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the whole pipeline in one process: from raw pairs to rectified images, disparity, depth and points."""

from __future__ import annotations

import time
from concurrent.futures import Future
from typing import Any, NamedTuple

from stereo_depth_ros.config import (
    CameraInfoConfig,
    CloudConfig,
    DepthConfig,
    MatchingConfig,
    PairingConfig,
    PipelineConfig,
    PriorConfig,
    RectificationConfig,
)
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.first_pairs_watch import FirstPairsWatch
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RAW_IMAGES, NodeInterface
from stereo_depth_ros.nodes.match_report import MatchReport
from stereo_depth_ros.nodes.pair_input import PairInput
from stereo_depth_ros.nodes.prior_input import PriorInput
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.outputs import LIVE_OUTPUTS, ResultMessages
from stereo_depth_ros.pipeline import PreparedPair, StereoPipeline, StereoResult

__all__ = ["StereoDepthNode", "main"]


class _Frame(NamedTuple):
    """A pair of messages, and the pipeline and the prior that were current when it arrived."""

    left: Any
    right: Any
    pipeline: StereoPipeline
    prior: DisparityPrior | None


class StereoDepthNode(StereoNode):
    """It computes and publishes the outputs that have a subscriber.

    While one pair is matched, the next is rectified and the last one published; sgbm matches one pair a core.
    """

    interface = NodeInterface(
        "stereo_depth_node",
        configs=(
            *(PairingConfig, CameraInfoConfig, MatchingConfig, DepthConfig, CloudConfig, RectificationConfig),
            PriorConfig,
        ),
        inputs=CAMERA_INFOS | RAW_IMAGES,
        outputs={row.topic: row.msgtype for row in LIVE_OUTPUTS},
    )

    def __init__(self) -> None:
        super().__init__()
        self._prior = PriorInput(self)
        self.parameters.require(MatchingConfig, self._check)
        self.refuse_equal_topics("left/image_raw", "right/image_raw")
        self._pipeline: StereoPipeline | None = None
        self._first_pairs = FirstPairsWatch(self)
        self._report = MatchReport(self.diagnostics)
        self._messages = ResultMessages(self.types)
        self._depth = BitDepth()
        self.on_idle += [self._depth.restart, self._messages.restart]
        self._calibration = CalibrationInput(self)
        self._results = [(self.add_output(row.topic), row.topic, row.build) for row in LIVE_OUTPUTS]
        self.overlap_frames(self._prepare, self._match, self._publish, lambda frame: frame.pipeline.at_once)
        self._pairs = PairInput(self, "left/image_raw", "right/image_raw", self._on_pair)
        self.add_input("left/image_raw", self._pairs.add_left)
        self.add_input("right/image_raw", self._pairs.add_right)

    def _check(self, config: MatchingConfig) -> None:
        self._prior.check(config)
        self.check_matcher(config)

    def _on_pair(self, left: Any, right: Any) -> None:
        self._calibration.with_rig(lambda rig: self._add(left, right, rig), left, right)

    def _add(self, left: Any, right: Any, rig: StereoRig) -> None:
        self._pairs.check(left, right, rig)
        prior = self._prior.of(rig, stamp_ns(left.header))
        self.add_frame(_Frame(left, right, self._pipeline_of(rig), prior))

    def _prepare(self, frame: _Frame) -> tuple[_Frame, PreparedPair]:
        pair = self._pairs.decode(frame.left, frame.right)
        return frame, frame.pipeline.prepare(pair)

    def _match(self, prepared: tuple[_Frame, PreparedPair]) -> tuple[StereoPipeline, StereoResult]:
        frame, pair = prepared
        return frame.pipeline, frame.pipeline.match(pair, frame.prior)

    def _publish(self, future: Future[tuple[StereoPipeline, StereoResult]]) -> None:
        with self._first_pairs.refusing():
            pipeline, result = future.result()
            rig, (left, right) = result.calibrated_rig, (result.rectified.left, result.rectified.right)
            self._report.note(result.disparity)
            self._first_pairs.look(rig, pipeline.shown, result.pair, left, right, result.disparity)
        for output, topic, build in self._results:
            if output.wanted:
                start = time.perf_counter()
                message = build(self._messages, result)
                built = time.perf_counter()
                output.publish(message)
                sent = time.perf_counter()
                result.timings_ms[f"make {topic}"] = 1e3 * (built - start)
                result.timings_ms[f"send {topic}"] = 1e3 * (sent - built)
        self.diagnostics.timing(result.timings_ms)

    def _pipeline_of(self, rig: StereoRig) -> StereoPipeline:
        """Rebuilt when the rig changes; for a changed parameter only its stage is rebuilt."""
        config = self._config()
        if self._pipeline is None or self._pipeline.rig is not rig:
            self._pipeline = StereoPipeline(config, rig, self._depth)
        elif self._pipeline.config != config:
            self._pipeline = self._pipeline.with_config(config)
        return self._pipeline

    def _config(self) -> PipelineConfig:
        get = self.parameters.get
        return PipelineConfig(
            get(PairingConfig), get(MatchingConfig), get(DepthConfig), get(CloudConfig), get(RectificationConfig)
        )


def main() -> int:
    """Run the node."""
    return run(StereoDepthNode)


if __name__ == "__main__":
    raise SystemExit(main())

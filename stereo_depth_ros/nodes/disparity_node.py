# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matches rectified pairs: left, right image_rect to disparity."""

from __future__ import annotations

import functools
from concurrent.futures import Future
from typing import Any, NamedTuple

from stereo_depth_ros.config import CameraInfoConfig, MatchingConfig, PairingConfig, PipelineConfig, PriorConfig
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8, MatchResult, RectifiedPair, StereoPair
from stereo_depth_ros.matching.protocol import Images
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.first_pairs_watch import FirstPairsWatch
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RECTIFIED_IMAGES, NodeInterface
from stereo_depth_ros.nodes.match_report import MatchReport
from stereo_depth_ros.nodes.pair_input import PairInput
from stereo_depth_ros.nodes.prior_input import PriorInput
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.outputs import MATCH_OUTPUTS, OUTPUTS, ResultMessages
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.stages.disparity import DisparityStage
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["DisparityNode", "main"]


_OUTPUTS = (*(row for row in OUTPUTS if row.topic == "disparity"), *MATCH_OUTPUTS)


class _Frame(NamedTuple):
    """A pair of messages, and what was current when it arrived."""

    left: Any
    right: Any
    rig: StereoRig
    config: MatchingConfig
    rectifier: Rectifier
    stage: DisparityStage
    prior: DisparityPrior | None


class _Decoded(NamedTuple):
    """A frame, its images in gray, and those before it that are matched together with it."""

    frame: _Frame
    pair: StereoPair
    left: U8
    right: U8
    earlier: tuple[Images, ...]


class DisparityNode(StereoNode):
    """The matcher is that of the parameter stereo_algorithm. Pairs overlap as in stereo_depth_node."""

    interface = NodeInterface(
        "disparity_node",
        configs=(PairingConfig, CameraInfoConfig, MatchingConfig, PriorConfig),
        inputs=CAMERA_INFOS | RECTIFIED_IMAGES,
        outputs={row.topic: row.msgtype for row in _OUTPUTS},
    )

    def __init__(self) -> None:
        super().__init__()
        self._prior = PriorInput(self)
        self.parameters.require(MatchingConfig, self._check)
        self.refuse_equal_topics("left/image_rect", "right/image_rect")
        self._messages = ResultMessages(self.types)
        self._rectifier = functools.lru_cache(maxsize=1)(Rectifier)
        self._stage = functools.lru_cache(maxsize=1)(DisparityStage)
        self._first_pairs = FirstPairsWatch(self)
        self._report = MatchReport(self.diagnostics)
        self._calibration = CalibrationInput(self, rectified=True)
        self._results = [(self.add_output(row.topic), row.build) for row in _OUTPUTS]
        self.overlap_frames(self._prepare, self._match, self._publish, lambda frame: frame.stage.at_once)
        self._pairs = PairInput(self, "left/image_rect", "right/image_rect", self._on_pair)
        self.add_input("left/image_rect", self._pairs.add_left)
        self.add_input("right/image_rect", self._pairs.add_right)

    def _check(self, config: MatchingConfig) -> None:
        self._prior.check(config)
        self.check_matcher(config)

    def _on_pair(self, left: Any, right: Any) -> None:
        self._calibration.with_rig(lambda rig: self._add(left, right, rig), left, right)

    def _add(self, left: Any, right: Any, rig: StereoRig) -> None:
        self._pairs.check(left, right, rig)
        config, rectifier = self.parameters.get(MatchingConfig), self._rectifier(rig)
        prior = self._prior.of(rig, stamp_ns(left.header))
        self.add_frame(_Frame(left, right, rig, config, rectifier, self._stage(config, rectifier), prior))

    def _prepare(self, frame: _Frame) -> _Decoded:
        pair = self._pairs.decode(frame.left, frame.right)
        left, right = to_gray(pair.left), to_gray(pair.right)
        return _Decoded(frame, pair, left, right, frame.stage.earlier(left, right, pair.left.stamp_ns))

    def _match(self, decoded: _Decoded) -> tuple[_Decoded, MatchResult]:
        with self.diagnostics.timed("match"):
            frame = decoded.frame
            match = frame.stage.match(decoded.left, decoded.right, earlier=decoded.earlier, prior=frame.prior)
        return decoded, match

    def _publish(self, future: Future[tuple[_Decoded, MatchResult]]) -> None:
        with self._first_pairs.refusing():
            (frame, pair, left, right, _), match = future.result()
            self._report.note(match)
            self._first_pairs.look(frame.rig, frame.rectifier.shown, pair, left, right, match)
        rectified, config = RectifiedPair(left, right, left, "mono8"), PipelineConfig(matching=frame.config)
        result = StereoResult(pair, rectified, match, frame.rig, config, {}, frame.rectifier)
        for output, build in self._results:
            if output.wanted:
                output.publish(build(self._messages, result))


def main() -> int:
    """Run the node."""
    return run(DisparityNode)


if __name__ == "__main__":
    raise SystemExit(main())

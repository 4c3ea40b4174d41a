# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matches rectified pairs: left, right image_rect to disparity."""

from __future__ import annotations

import functools
from typing import Any

from stereo_depth_ros.config import MatchingConfig, PairingConfig
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.disparity import match_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.first_pairs_watch import FirstPairsWatch
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RECTIFIED_IMAGES, NodeInterface
from stereo_depth_ros.nodes.pair_input import PairInput
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.stages.disparity import DisparityStage
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["DisparityNode", "main"]


class DisparityNode(StereoNode):
    """The matcher is that of the parameter stereo_algorithm."""

    interface = NodeInterface(
        "disparity_node",
        configs=(PairingConfig, MatchingConfig),
        inputs=CAMERA_INFOS | RECTIFIED_IMAGES,
        outputs={"disparity": "stereo_msgs/msg/DisparityImage"},
    )

    def __init__(self) -> None:
        super().__init__()
        self.parameters.require(MatchingConfig, self.check_matcher)
        self.refuse_equal_topics("left/image_rect", "right/image_rect")
        self._pool = PayloadPool(self.types)
        self._rectifier = functools.lru_cache(maxsize=1)(Rectifier)
        self._stage = functools.lru_cache(maxsize=1)(DisparityStage)
        self._first_pairs = FirstPairsWatch(self)
        self._calibration = CalibrationInput(self, rectified=True)
        self._output = self.add_output("disparity")
        self._pairs = PairInput(self, "left/image_rect", "right/image_rect", self._on_pair)
        self.add_input("left/image_rect", self._pairs.add_left)
        self.add_input("right/image_rect", self._pairs.add_right)

    def _on_pair(self, left: Any, right: Any) -> None:
        self._calibration.with_rig(lambda rig: self._match(left, right, rig), left, right)

    def _match(self, left: Any, right: Any, rig: StereoRig) -> None:
        config = self.parameters.get(MatchingConfig)
        pair = self._pairs.decode(left, right, rig)
        left, right, rectifier = to_gray(pair.left), to_gray(pair.right), self._rectifier(rig)
        with self._first_pairs.refusing():
            with self.diagnostics.timed("match"):
                match = self._stage(config, rectifier).match(left, right)
            self._first_pairs.look(rig, rectifier.shown, pair, left, right, match)
        self._output.publish(match_message(self.types, self._pool, match, config, rig, pair.left))


def main() -> int:
    """Run the node."""
    return run(DisparityNode)


if __name__ == "__main__":
    raise SystemExit(main())

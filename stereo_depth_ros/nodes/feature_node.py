# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Computes sparse points from rectified pairs: left, right image_rect to features/points2."""

from __future__ import annotations

import functools
from typing import Any

from stereo_depth_ros.config import CameraInfoConfig, MatchingConfig, PairingConfig, PointConfig
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.messages.point_cloud import sparse_cloud_message
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RECTIFIED_IMAGES, NodeInterface
from stereo_depth_ros.nodes.pair_input import PairInput
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.stages.features import FeatureStage
from stereo_depth_ros.stages.point_cloud import CloudLayout
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["FeatureNode", "main"]


class FeatureNode(StereoNode):
    """The matcher is always features, not that of stereo_algorithm: one parameter file serves all nodes."""

    interface = NodeInterface(
        "feature_node",
        configs=(PairingConfig, CameraInfoConfig, MatchingConfig, PointConfig),
        inputs=CAMERA_INFOS | RECTIFIED_IMAGES,
        outputs={"features/points2": "sensor_msgs/msg/PointCloud2"},
    )
    matcher = "features"

    def __init__(self) -> None:
        super().__init__()
        self.refuse_equal_topics("left/image_rect", "right/image_rect")
        self._rectifier = functools.lru_cache(maxsize=1)(Rectifier)
        self._stage = functools.lru_cache(maxsize=1)(FeatureStage)
        self._calibration = CalibrationInput(self, rectified=True)
        self._output = self.add_output("features/points2")
        self._pairs = PairInput(self, "left/image_rect", "right/image_rect", self._on_pair)
        self.add_input("left/image_rect", self._pairs.add_left)
        self.add_input("right/image_rect", self._pairs.add_right)

    def _on_pair(self, left: Any, right: Any) -> None:
        self._calibration.with_rig(lambda rig: self._publish(left, right, rig), left, right)

    def _publish(self, left: Any, right: Any, rig: StereoRig) -> None:
        config = self.parameters.get(MatchingConfig)
        self._pairs.check(left, right, rig)
        pair = self._pairs.decode(left, right)
        with self.diagnostics.timed("match"):
            matches = self._stage(config, self._rectifier(rig)).find(to_gray(pair.left), to_gray(pair.right))
        points_m = matches.points_m(Triangulation.from_rig(rig))
        layout = CloudLayout.of(self.parameters.get(PointConfig))
        stamp_ns, frame_id = pair.left.stamp_ns, pair.left.frame_id
        rgb = matches.colors(pair.left)
        self._output.publish(
            sparse_cloud_message(self.types, points_m, rgb, layout, stamp_ns=stamp_ns, frame_id=frame_id)
        )


def main() -> int:
    """Run the node."""
    return run(FeatureNode)


if __name__ == "__main__":
    raise SystemExit(main())

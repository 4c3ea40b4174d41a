# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Computes depth from published disparities: disparity to depth/image_rect and depth/camera_info (REP 118)."""

from __future__ import annotations

from typing import Any

from stereo_depth_ros.config import CameraInfoConfig, DepthConfig, PairingConfig
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import rectified_camera_info
from stereo_depth_ros.messages.depth import depth_message
from stereo_depth_ros.messages.disparity import published_disparity, published_triangulation
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, NodeInterface
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.stages.depth import depth_from_disparity

__all__ = ["DepthNode", "main"]


class DepthNode(StereoNode):
    """Depth is in meters or millimeters, see the parameter depth_encoding."""

    interface = NodeInterface(
        "depth_node",
        configs=(PairingConfig, CameraInfoConfig, DepthConfig),
        inputs={**CAMERA_INFOS, "disparity": "stereo_msgs/msg/DisparityImage"},
        outputs={"depth/image_rect": "sensor_msgs/msg/Image", "depth/camera_info": "sensor_msgs/msg/CameraInfo"},
    )

    def __init__(self) -> None:
        super().__init__()
        self._pool = PayloadPool(self.types)
        self._calibration = CalibrationInput(self, rectified=True)
        self._image = self.add_output("depth/image_rect")
        self._info = self.add_output("depth/camera_info")
        self.add_input("disparity", self._receive)

    def _receive(self, message: Any) -> None:
        self._calibration.with_rig(lambda rig: self._publish(message, rig), message)

    def _publish(self, message: Any, rig: StereoRig) -> None:
        topic = self.resolve_topic_name("disparity")
        stamp, frame_id = stamp_ns(message.header), message.header.frame_id
        with self.diagnostics.timed("depth"):
            disparity_px = published_disparity(message, topic)
            depth_m = depth_from_disparity(disparity_px, published_triangulation(message, rig, topic))
        encoding = self.parameters.get(DepthConfig).depth_encoding
        self._image.publish(depth_message(self.types, self._pool, depth_m, encoding, stamp, frame_id))
        self._info.publish(rectified_camera_info(self.types, rig.left, stamp, frame_id))


def main() -> int:
    """Run the node."""
    return run(DepthNode)


if __name__ == "__main__":
    raise SystemExit(main())

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectifies each image on arrival: left, right image_raw to image_rect (gray) and image_rect_color."""

from __future__ import annotations

import functools
from typing import Any

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RAW_IMAGES, NodeInterface
from stereo_depth_ros.nodes.pair_input import decode_side
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["RectifyNode", "main"]


class RectifyNode(StereoNode):
    """Each camera is rectified by itself, without waiting for the image of the other one."""

    interface = NodeInterface(
        "rectify_node",
        configs=(PairingConfig,),
        inputs=CAMERA_INFOS | RAW_IMAGES,
        outputs={
            f"{side}/{name}": "sensor_msgs/msg/Image"
            for side in ("left", "right")
            for name in ("image_rect", "image_rect_color")
        },
    )

    def __init__(self) -> None:
        super().__init__()
        self.refuse_equal_topics("left/image_raw", "right/image_raw")
        self._pool = PayloadPool(self.types)
        self._rectifier = functools.lru_cache(maxsize=1)(Rectifier)
        self._calibration = CalibrationInput(self)
        self._sides = {side: self._add_side(side) for side in ("left", "right")}

    def _add_side(self, side: str) -> tuple[Any, Any]:
        def receive(message: Any) -> None:
            self._calibration.with_rig(lambda rig: self._rectify(side, message, rig))

        self.add_input(f"{side}/image_raw", receive)
        return self.add_output(f"{side}/image_rect"), self.add_output(f"{side}/image_rect_color")

    def _rectify(self, side: str, message: Any, rig: StereoRig) -> None:
        gray_output, color_output = self._sides[side]
        rectifier = self._rectifier(rig)
        rectify = rectifier.rectify_left if side == "left" else rectifier.rectify_right
        frame = decode_side(self, side, f"{side}/image_raw", message, rig)
        with self.diagnostics.timed(f"rectify {side}"):
            for output, pixels, encoding in (
                (gray_output, to_gray(frame) if gray_output.wanted else None, "mono8"),
                (color_output, frame.pixels if color_output.wanted else None, frame.encoding),
            ):
                if pixels is not None:
                    payload = self._pool.get(f"{side} {encoding}", pixels.nbytes)
                    rectified = rectify(pixels, payload[1].reshape(pixels.shape))
                    output.publish(
                        image_message(self.types, rectified, encoding, frame.stamp_ns, frame.frame_id, payload)
                    )


def main() -> int:
    """Run the node."""
    return run(RectifyNode)


if __name__ == "__main__":
    raise SystemExit(main())

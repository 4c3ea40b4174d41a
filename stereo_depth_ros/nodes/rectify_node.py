# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectifies each image on arrival: left, right image_raw to image_rect (gray) and image_rect_color."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import Frame
from stereo_depth_ros.messages.image import has_16_bit, image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RAW_IMAGES, NodeInterface
from stereo_depth_ros.nodes.pair_input import PairInput, decode_side
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["RectifyNode", "main"]


class RectifyNode(StereoNode):
    """Each camera is rectified by itself, without waiting for the other one; 16-bit images need it for their scale."""

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
        self._pairs = PairInput(self, "left/image_raw", "right/image_raw", self._on_pair)
        self._sides = {
            "left": self._add_side("left", self._pairs.add_left),
            "right": self._add_side("right", self._pairs.add_right),
        }

    def _add_side(self, side: str, add: Callable[[Any], None]) -> tuple[Any, Any]:
        def receive(message: Any) -> None:
            if has_16_bit(message):
                add(message)
            else:
                self._calibration.with_rig(lambda rig: self._rectify_side(side, message, rig), message)

        self.add_input(f"{side}/image_raw", receive)
        return self.add_output(f"{side}/image_rect"), self.add_output(f"{side}/image_rect_color")

    def _on_pair(self, left: Any, right: Any) -> None:
        self._calibration.with_rig(lambda rig: self._rectify_pair(left, right, rig), left, right)

    def _rectify_pair(self, left: Any, right: Any, rig: StereoRig) -> None:
        pair = self._pairs.decode(left, right, rig)
        self._rectify("left", pair.left, rig)
        self._rectify("right", pair.right, rig)

    def _rectify_side(self, side: str, message: Any, rig: StereoRig) -> None:
        self._rectify(side, decode_side(self, side, f"{side}/image_raw", message, rig), rig)

    def _rectify(self, side: str, frame: Frame, rig: StereoRig) -> None:
        gray_output, color_output = self._sides[side]
        rectifier = self._rectifier(rig)
        rectify = rectifier.rectify_left if side == "left" else rectifier.rectify_right
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

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectifies each image on arrival: left, right image_raw to image_rect (gray) and image_rect_color."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from stereo_depth_ros.config import CameraInfoConfig, PairingConfig, RectificationConfig
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import Frame
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RAW_IMAGES, NodeInterface
from stereo_depth_ros.nodes.pair_input import check_side, decode_from
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.stages.rectification import Rectifier, gray_of_camera

__all__ = ["RectifyNode", "main"]

_GRAY, _COLOR = "image_rect", "image_rect_color"
_RAW_GRAY, _RAW_COLOR = "image_mono", "image_color"


class RectifyNode(StereoNode):
    """Each camera is rectified by itself, without waiting for the other one; bits and alpha are kept.

    Gray and color are published before rectification too, as image_mono and image_color, without a calibration.
    """

    interface = NodeInterface(
        "rectify_node",
        configs=(PairingConfig, CameraInfoConfig, RectificationConfig),
        inputs=CAMERA_INFOS | RAW_IMAGES,
        outputs={
            f"{side}/{name}": "sensor_msgs/msg/Image"
            for side in ("left", "right")
            for name in (_GRAY, _COLOR, _RAW_GRAY, _RAW_COLOR)
        },
    )

    def __init__(self) -> None:
        super().__init__()
        self.refuse_equal_topics("left/image_raw", "right/image_raw")
        self._pool = PayloadPool(self.types)
        self._rectifier = functools.lru_cache(maxsize=1)(Rectifier)
        self._calibration = CalibrationInput(self)
        self._images = {topic: self.add_output(topic) for topic in self.interface.outputs}
        for side in ("left", "right"):
            self.add_input(f"{side}/image_raw", functools.partial(self._receive, side))

    def _receive(self, side: str, message: Any) -> None:
        decode = functools.cache(lambda: decode_from(self, f"{side}/image_raw", message))  # once for all outputs
        if self._wanted(side, _RAW_GRAY, _RAW_COLOR):
            self._publish(side, decode(), _RAW_GRAY, _RAW_COLOR, lambda pixels, _: pixels)
        if self._wanted(side, _GRAY, _COLOR):
            self._calibration.with_rig(lambda rig: self._rectify(side, message, decode, rig), message)

    def _wanted(self, side: str, *names: str) -> bool:
        return any(self._images[f"{side}/{name}"].wanted for name in names)

    def _rectify(self, side: str, message: Any, decode: Callable[[], Frame], rig: StereoRig) -> None:
        check_side(self, side, f"{side}/image_raw", message, rig)
        frame = decode()
        rectifier = self._rectifier(rig)
        rectify = rectifier.rectify_left if side == "left" else rectifier.rectify_right
        with self.diagnostics.timed(f"rectify {side}"):
            self._publish(side, frame, _GRAY, _COLOR, rectify)

    def _publish(
        self,
        side: str,
        frame: Frame,
        gray: str,
        color: str,
        convert: Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]],
    ) -> None:
        """Publish what is wanted of both, converted into a buffer of the same shape."""
        if self._wanted(side, gray):
            pixels = gray_of_camera(frame)
            self._send(f"{side}/{gray}", pixels, "mono8" if pixels.itemsize == 1 else "mono16", frame, convert)
        if self._wanted(side, color):
            pixels, encoding = self._color(frame)
            self._send(f"{side}/{color}", pixels, encoding, frame, convert)

    def _color(self, frame: Frame) -> tuple[NDArray[Any], str]:
        if frame.camera is None:
            return frame.pixels, frame.encoding
        return frame.camera.color(self.parameters.get(RectificationConfig).debayer), frame.camera.encoding

    def _send(
        self,
        topic: str,
        pixels: NDArray[Any],
        encoding: str,
        frame: Frame,
        convert: Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]],
    ) -> None:
        payload = self._pool.get(topic, pixels.nbytes)
        converted = convert(pixels, payload[1].view(pixels.dtype).reshape(pixels.shape))
        message = image_message(self.types, converted, encoding, frame.stamp_ns, frame.frame_id, payload)
        self._images[topic].publish(message)


def main() -> int:
    """Run the node."""
    return run(RectifyNode)


if __name__ == "__main__":
    raise SystemExit(main())

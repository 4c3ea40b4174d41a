# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Draws views of rectified pairs and their disparities: an image from in between, anaglyphs and color maps."""

from __future__ import annotations

import functools
from typing import Any

from rclpy.parameter import Parameter

from stereo_depth_ros.config import CameraInfoConfig, PairingConfig, ViewConfig, replace_checked
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, NodeInterface
from stereo_depth_ros.nodes.pair_input import PairInput
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.views.frame import RECTIFIED, ViewFrame
from stereo_depth_ros.views.topics import VIEWS, ViewMessages

__all__ = ["ViewNode", "main"]

_DISPARITY, _POSITION = "disparity", "view/position"
_IMAGE_BYTES = 256 << 20  # of the pairs that wait for their disparities
_DEPTH = 30  # images that arrive while one frame is drawn
_WITHOUT_IMAGES, _WITHOUT_DISPARITIES = "disparities without images", "images without disparities"


class ViewNode(StereoNode):
    """A message on view/position sets the parameter view_position. Color maps need no images and do not wait for them.

    Views have the stamp and the frame_id of the left image. A pair is kept until its disparity arrives, however long
    the matcher takes: 256 MiB of them, and queue_size pairs at least.
    """

    interface = NodeInterface(
        "view_node",
        configs=(PairingConfig, CameraInfoConfig, ViewConfig),
        inputs={
            **CAMERA_INFOS,
            _DISPARITY: "stereo_msgs/msg/DisparityImage",
            **dict.fromkeys(RECTIFIED, "sensor_msgs/msg/Image"),
            _POSITION: "std_msgs/msg/Float64",
        },
        outputs=dict.fromkeys(VIEWS, "sensor_msgs/msg/Image"),
    )

    def __init__(self) -> None:
        super().__init__()
        self.refuse_equal_topics(*RECTIFIED)
        self._messages = ViewMessages(self.types)
        self._calibration = CalibrationInput(self, rectified=True)
        self._views = {topic: self.add_output(topic) for topic in VIEWS}
        self._pairs = PairInput(self, *RECTIFIED, self._on_images)
        queue_size = self.parameters.get(PairingConfig).queue_size
        self._frames: StereoPairing[Any] = StereoPairing(PairingConfig(queue_size=queue_size))
        self.diagnostics.watch_loss(_WITHOUT_IMAGES, self._cause_of_loss, self._lost)
        self.on_idle += [self._frames.flush, self._messages.restart]
        self.add_input(_DISPARITY, self._receive)
        takers = (self._pairs.add_left, self._pairs.add_right)
        self._images = [
            self.add_input(topic, take, self._needs_images, _DEPTH)
            for topic, take in zip(RECTIFIED, takers, strict=True)
        ]
        self.add_input(_POSITION, self._move)

    def _needs_images(self) -> bool:
        return any(self._wanted(needs_images=True))

    def _wanted(self, needs_images: bool) -> list[str]:
        """The views with a subscriber that need images, or those that do not."""
        return [t for t, output in self._views.items() if output.wanted and VIEWS[t].needs_images == needs_images]

    def _move(self, message: Any) -> None:
        try:
            replace_checked(self.parameters.get(ViewConfig), {"view_position": message.data})
        except ConfigError as error:
            raise error.about(self.resolve_topic_name(_POSITION)) from error
        self.set_parameters([Parameter("view_position", value=float(message.data))])

    def _receive(self, disparity: Any) -> None:
        if topics := self._wanted(needs_images=False):
            self._calibration.with_rig(functools.partial(self._publish, topics, disparity, None), disparity)
        if self._needs_images():
            for images in self._images:
                images.take_waiting()  # its own are among them; the executor takes one for each disparity
            self._deliver(self._frames.add_left(stamp_ns(disparity.header), disparity))

    def _on_images(self, left: Any, right: Any) -> None:
        nbytes = len(left.data) + len(right.data)
        self._frames.right_queue_size = max(
            _IMAGE_BYTES // max(1, nbytes), self.parameters.get(PairingConfig).queue_size
        )
        self._deliver(self._frames.add_right(stamp_ns(left.header), (left, right)))

    def _deliver(self, frames: list[tuple[Any, Any]]) -> None:
        counts = self._frames.counts
        self.diagnostics.counters[_WITHOUT_IMAGES] = counts.dropped_left
        self.diagnostics.counters[_WITHOUT_DISPARITIES] = counts.dropped_right
        topics = self._wanted(needs_images=True)
        for disparity, images in frames:
            with self.diagnostics.catch():
                self._calibration.with_rig(functools.partial(self._publish, topics, disparity, images), disparity)

    def _publish(self, topics: list[str], disparity: Any, images: tuple[Any, Any] | None, rig: StereoRig) -> None:
        pair = None
        if images is not None:
            left, right = images
            self._pairs.check(left, right, rig)
            pair = self._pairs.decode(left, right)
        frame = ViewFrame.of_message(disparity, rig, pair, self.resolve_topic_name(_DISPARITY))
        config = self.parameters.get(ViewConfig)
        for topic in topics:
            with self.diagnostics.timed(topic):
                message = self._messages.build(topic, frame, config)
            self._views[topic].publish(message)

    def _lost(self) -> int:
        """Disparities without images, but for the first few: one input is connected before the other."""
        queue_size = self.parameters.get(PairingConfig).queue_size
        return max(0, self.diagnostics.counters[_WITHOUT_IMAGES] - queue_size)

    def _cause_of_loss(self) -> str:
        left, right = (self.resolve_topic_name(topic) for topic in RECTIFIED)
        return (
            f"{left} and {right} have no images with the stamps of the disparities: remap the images of these cameras"
        )


def main() -> int:
    """Run the node."""
    return run(ViewNode)


if __name__ == "__main__":
    raise SystemExit(main())

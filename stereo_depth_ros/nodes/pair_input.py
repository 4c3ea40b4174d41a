# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs the messages of two topics by their stamps; decodes images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import Frame, StereoPair
from stereo_depth_ros.messages.bit_depth import BitDepth
from stereo_depth_ros.messages.image import decode, decode_pair, image_size
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode

__all__ = ["PairInput", "decode_from", "decode_side"]


class PairInput:
    """Pairs the messages of two topics; images are not decoded before a pair exists.

    Args:
        node: counts pairs and dropped messages.
        left, right: topics, for diagnostics.
        on_pair: called with each pair, in the order of stamps.
    """

    def __init__(self, node: StereoNode, left: str, right: str, on_pair: Callable[[Any, Any], None]) -> None:
        self._node = node
        self._pairing: StereoPairing[Any] = StereoPairing(node.parameters.get(PairingConfig))
        self._topics = (left, right)
        self._on_pair = on_pair
        self._backwards = 0
        self._depth = BitDepth()
        node.on_idle.append(self._restart)

    def add_left(self, message: Any) -> None:
        """A message of the left topic."""
        self._deliver(self._pairing.add_left(stamp_ns(message.header), message))

    def add_right(self, message: Any) -> None:
        """A message of the right topic."""
        self._deliver(self._pairing.add_right(stamp_ns(message.header), message))

    def decode(self, left: Any, right: Any, rig: StereoRig | None = None) -> StereoPair:
        """The frames of a pair, which come in the order of the pairs; all 16-bit images have one bit depth.

        Args:
            left, right: Image or CompressedImage.
            rig: the cameras; None checks nothing.

        Raises:
            MessageError: an image that cannot be decoded, with its topic.
            CalibrationError: the camera infos are those of the other camera, or of another size; nothing is decoded.
        """
        resolved = self._node.resolve_topic_name(self._topics[0]), self._node.resolve_topic_name(self._topics[1])
        if rig is not None:
            for side, message, topic in zip(("left", "right"), (left, right), resolved, strict=True):
                _check(rig, side, message, topic)
        return decode_pair(left, right, resolved, self._depth)

    def _restart(self) -> None:
        """While the node was idle its stream may have started again, with earlier stamps, and the cameras changed."""
        self._pairing.flush()
        self._depth = BitDepth()

    def _deliver(self, pairs: list[tuple[Any, Any]]) -> None:
        self._count()
        for left, right in pairs:
            with self._node.diagnostics.catch():
                self._on_pair(left, right)

    def _count(self) -> None:
        counts, counters = self._pairing.counts, self._node.diagnostics.counters
        left, right = self._topics
        counters["paired"] = counts.paired
        counters[f"unpaired {left}"] = counts.dropped_left
        counters[f"unpaired {right}"] = counts.dropped_right
        counters["duplicate stamps"] = counts.duplicates
        if counts.backwards > self._backwards:
            self._backwards = counts.backwards
            topics = ", ".join(self._node.resolve_topic_name(topic) for topic in self._topics)
            self._node.diagnostics.report_error(
                "stamps went backwards",
                f"{topics}: stamps went backwards, waiting messages were dropped: expected when a bag starts again, "
                "else check the clock of the camera driver",
            )


def _check(rig: StereoRig, side: str, message: Any, topic: str) -> None:
    size = image_size(message, topic)
    rig.check_side(side, message.header.frame_id, topic)
    rig.check_image(*size, topic)


def decode_from(node: StereoNode, topic: str, message: Any, depth: BitDepth | None = None) -> Frame:
    """The frame in an Image or CompressedImage; MessageError with the resolved topic."""
    return decode(message, node.resolve_topic_name(topic), depth)


def decode_side(node: StereoNode, side: str, topic: str, message: Any, rig: StereoRig) -> Frame:
    """The frame of a camera ("left" or "right"); CalibrationError where the camera infos differ."""
    _check(rig, side, message, node.resolve_topic_name(topic))
    return decode_from(node, topic, message)

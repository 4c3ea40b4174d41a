# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs the messages of two topics by their stamps; decodes images."""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Callable
from typing import Any

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import Frame, StereoPair
from stereo_depth_ros.core.unpaired import Arrival, cause_of_duplicates, cause_of_loss, unset_stamps
from stereo_depth_ros.messages.image import decode, decode_pair, image_size
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode

__all__ = ["PairInput", "check_side", "decode_from"]

_DUPLICATES = "duplicate stamps"


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
        self._names = (node.resolve_topic_name(left), node.resolve_topic_name(right))
        self._on_pair = on_pair
        self._backwards = 0
        # Enough of them to see a side that is later than the queue by much
        self._arrivals: deque[Arrival] = deque(maxlen=4 * node.parameters.get(PairingConfig).queue_size + 100)
        self._unset = 0  # stamps
        self._is_starting = True
        # Of each side; at a start one is connected before the other, and its first messages have no partner.
        self._unpaired_at_start, self._excused = [0, 0], [0, 0]
        for side, topic in enumerate(self._topics):
            node.diagnostics.watch_loss(f"unpaired {topic}", self._cause_of_loss, functools.partial(self._lost, side))
        node.diagnostics.watch_loss(_DUPLICATES, lambda: str(cause_of_duplicates(self._names)), self._duplicates)
        self._depth = BitDepth()
        node.on_idle.append(self._restart)

    def add_left(self, message: Any) -> None:
        """A message of the left topic."""
        stamp = self._note(message, 0)
        self._deliver(self._pairing.add_left(stamp, message))

    @property
    def waiting_right(self) -> int:
        """Number of right messages that wait for their partners."""
        return self._pairing.pending_right

    def keep_right(self, count: int) -> int:
        """Keep that many right messages until their partners arrive, and ``queue_size`` at least; the number."""
        self._pairing.right_queue_size = max(count, self._node.parameters.get(PairingConfig).queue_size)
        return self._pairing.right_queue_size

    def add_right(self, message: Any) -> None:
        """A message of the right topic."""
        stamp = self._note(message, 1)
        self._deliver(self._pairing.add_right(stamp, message))

    def _note(self, message: Any, side: int) -> int:
        stamp = stamp_ns(message.header, self._names[side])
        self._arrivals.append((side, stamp))
        if stamp == 0:
            self._unset += 1
            if error := unset_stamps(self._arrivals, self._names):
                self._node.diagnostics.report_error("stamps not set", str(error))
        return stamp

    def _cause_of_loss(self) -> str:
        limits, kept = self._node.parameters.get(PairingConfig), self._pairing.right_queue_size
        return str(cause_of_loss(self._arrivals, self._names, limits, kept))

    def _restart(self) -> None:
        """While the node was idle its stream may have started again, with earlier stamps, and the cameras changed."""
        self._pairing.flush()
        self._arrivals.clear()
        self._depth = BitDepth()
        self._excused = [before + self._few(side) for side, before in enumerate(self._excused)]
        self._unpaired_at_start = [0, 0]
        self._is_starting = True

    def _few(self, side: int) -> int:
        return min(self._unpaired_at_start[side], self._node.parameters.get(PairingConfig).queue_size)

    def _lost(self, side: int) -> int:
        """Unpaired messages of a side, but for the first few of every start."""
        return self._node.diagnostics.counters[f"unpaired {self._topics[side]}"] - self._excused[side] - self._few(side)

    def _duplicates(self) -> int:
        """Duplicate stamps, but for those that are not set, which are an error of their own."""
        return max(0, self._node.diagnostics.counters[_DUPLICATES] - self._unset)

    def check(self, left: Any, right: Any, rig: StereoRig) -> None:
        """Before anything of the size of the rig is built: whether it is that of the images, which are not decoded.

        Raises:
            MessageError: an image that is none, with its topic.
            CalibrationError: the camera infos are those of the other camera, or of another size.
        """
        for side, message, topic in zip(("left", "right"), (left, right), self._names, strict=True):
            _check(rig, side, message, topic)

    def decode(self, left: Any, right: Any) -> StereoPair:
        """The frames of a pair, which come in the order of the pairs; all 16-bit images have one bit depth.

        Args:
            left, right: Image or CompressedImage.

        Raises:
            MessageError: an image that cannot be decoded, with its topic.
        """
        return decode_pair(left, right, self._names, self._depth)

    def _deliver(self, pairs: list[tuple[Any, Any]]) -> None:
        self._count()
        for left, right in pairs:
            with self._node.diagnostics.catch():
                self._on_pair(left, right)

    def _count(self) -> None:
        counts, counters = self._pairing.counts, self._node.diagnostics.counters
        paired_before, counters["paired"] = counters["paired"], counts.paired
        for side, dropped in enumerate((counts.dropped_left, counts.dropped_right)):
            unpaired = f"unpaired {self._topics[side]}"
            grown, counters[unpaired] = dropped - counters[unpaired], dropped
            self._unpaired_at_start[side] += grown if self._is_starting else 0
        self._is_starting = self._is_starting and counts.paired == paired_before
        counters[_DUPLICATES] = counts.duplicates
        if counts.backwards > self._backwards:
            self._backwards = counts.backwards
            topics = ", ".join(self._names)
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


def check_side(node: StereoNode, side: str, topic: str, message: Any, rig: StereoRig) -> None:
    """Raise CalibrationError where the camera info of a camera ("left" or "right") does not fit its message."""
    _check(rig, side, message, node.resolve_topic_name(topic))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The input of the doctor: a stereo setup, built from the serialized messages of a bag or a graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from stereo_depth_ros.bags.topics import StereoTopics
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.finding import Finding
from stereo_depth_ros.messages.cdr import cdr_stamp_ns, without_stamp
from stereo_depth_ros.messages.image import decode, decode_pair

__all__ = ["NEAR", "PAIRS_EXAMINED", "CameraRecord", "StereoSetup", "Survey"]

PAIRS_EXAMINED = 6  # from all over the recording: a few hundred features each, half a second each
# Stamps within this time may be one exposure: half the period of 50 Hz.
NEAR = PairingConfig(approximate_sync=True, approximate_sync_tolerance_seconds=0.01)


@dataclass(frozen=True)
class CameraRecord:
    """Messages received from one camera.

    Attributes:
        image_topic, info_topic: names; info_topic is None where there is none.
        stamps_ns: header stamps of all images, in order of arrival.
        infos: the different sensor_msgs/CameraInfo received, of any message family, the first one first.
    """

    image_topic: str
    info_topic: str | None = None
    stamps_ns: Sequence[int] = ()
    infos: Sequence[Any] = ()


@dataclass(frozen=True)
class StereoSetup:
    """What there is to examine.

    Attributes:
        source: the bag, or the graph.
        left, right: messages of the cameras.
        pairs: a few pairs, from all over the recording.
        rectified: the names of the topics state that the images are rectified already.
        findings: what went wrong during the survey.
        silent: by topic without messages, what to do about it.
        bits: bit depth of the 16-bit images of ``pairs``; 0 where the images have 8 bits.
    """

    source: str
    left: CameraRecord
    right: CameraRecord
    pairs: Sequence[StereoPair] = ()
    rectified: bool = False
    findings: Sequence[Finding] = ()
    silent: Mapping[str, str] = field(default_factory=dict)
    bits: int = 0


class Survey:
    """Builds a stereo setup from serialized messages; a message that cannot be read becomes a finding.

    Args:
        source: the bag, or the graph.
        topics: of both cameras.
        deserialize: message from CDR bytes and type name, such as "sensor_msgs/msg/Image"; raises MessageError.

    Attributes:
        findings: so far.
    """

    def __init__(self, source: str, topics: StereoTopics, deserialize: Callable[[bytes, str], Any]) -> None:
        self._source = source
        self._topics = topics
        self._deserialize = deserialize
        self._image_topics = {"left": topics.left_image, "right": topics.right_image}
        self._info_topics = {"left": topics.left_info, "right": topics.right_info}
        self._stamps_ns: dict[str, list[int]] = {"left": [], "right": []}
        self._infos: dict[str, dict[bytes, bytes]] = {"left": {}, "right": {}}  # by what follows the stamp
        self._pairs: list[StereoPair] = []
        self._depth = BitDepth()
        self.findings: list[Finding] = []

    @property
    def empty(self) -> bool:
        """Neither an image nor a camera info was added."""
        return not any((*self._stamps_ns.values(), *self._infos.values()))

    def add_info(self, side: str, data: bytes) -> None:
        """A camera info of "left" or "right"."""
        self._infos[side].setdefault(without_stamp(data), data)

    def add_image(self, side: str, data: bytes) -> int | None:
        """The stamp of an image of "left" or "right", ns; None where it cannot be read."""
        try:
            stamp_ns = cdr_stamp_ns(data)
        except MessageError as error:
            self._refuse(f"images of {self._image_topics[side]}", error)
            return None
        self._stamps_ns[side].append(stamp_ns)
        return stamp_ns

    def add_pair(self, left: bytes, right: bytes) -> None:
        """Both images of a pair to examine."""
        topics = self._image_topics["left"], self._image_topics["right"]
        try:
            messages = (
                self._deserialize(left, self._topics.image_type),
                self._deserialize(right, self._topics.image_type),
            )
            self._pairs.append(decode_pair(*messages, topics, self._depth))
        except MessageError:
            self._examine_image("left", left)
            self._examine_image("right", right)

    def setup(self, silent: Mapping[str, str] | None = None) -> StereoSetup:
        """The setup; ``silent`` as of :class:`StereoSetup`."""
        left, right = self._record("left"), self._record("right")
        pairs, rectified = self._pairs, self._topics.rectified
        findings, bits = tuple(self.findings), self._depth.bits
        return StereoSetup(self._source, left, right, pairs, rectified, findings, silent or {}, bits)

    def _record(self, side: str) -> CameraRecord:
        infos = []
        for data in self._infos[side].values():
            try:
                infos.append(self._deserialize(data, "sensor_msgs/msg/CameraInfo"))
            except MessageError as error:
                self._refuse(f"camera infos of {self._info_topics[side]}", error)
        return CameraRecord(self._image_topics[side], self._info_topics[side], self._stamps_ns[side], infos)

    def _examine_image(self, side: str, data: bytes) -> None:
        """A finding where the image cannot be decoded."""
        topic = self._image_topics[side]
        try:
            decode(self._deserialize(data, self._topics.image_type), topic)
        except MessageError as error:
            self._refuse(f"images of {topic}", error)

    def _refuse(self, check: str, error: MessageError) -> None:
        """The first error of a topic stands for all."""
        if not any(finding.check == check for finding in self.findings):
            self.findings.append(Finding.refused(check, error))

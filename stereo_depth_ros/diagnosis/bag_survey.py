# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gathers from a bag what the doctor examines."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from stereo_depth_ros.bags.reader import BagMessage, BagReader
from stereo_depth_ros.bags.topics import StereoTopics
from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.core.types import Frame, StereoPair
from stereo_depth_ros.diagnosis.checks.streams import NEAR
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.diagnosis.survey import PAIRS_LOOKED_AT, CameraRecord, StereoSetup
from stereo_depth_ros.messages.cdr import cdr_stamp_ns, without_stamp
from stereo_depth_ros.messages.image import decode

__all__ = ["survey_bag"]


def survey_bag(
    path: Path,
    left: str | None = None,
    right: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StereoSetup:
    """Reads the stamps of all images and the camera infos, decodes a few pairs.

    Args:
        path: the bag.
        left, right: image topics where they are known.
        progress: called with messages read and messages to read.

    Raises:
        BagError: not a readable bag.
        TopicError: no stereo pair in it.
    """
    with BagReader(path) as reader:
        return _BagSurvey(reader, reader.stereo_topics(left, right)).run(progress)


class _BagSurvey:
    """One pass over the stamps and camera infos, then a look at the chosen pairs."""

    def __init__(self, reader: BagReader, topics: StereoTopics) -> None:
        self._reader = reader
        self._topics = topics
        self._images: dict[str, list[tuple[int, int]]] = {topics.left_image: [], topics.right_image: []}
        self._infos: dict[str, dict[bytes, BagMessage]] = {
            topic: {} for topic in (topics.left_info, topics.right_info) if topic is not None
        }
        self._findings: list[Finding] = []

    def run(self, progress: Callable[[int, int], None]) -> StereoSetup:
        """See :func:`survey_bag`."""
        if self._reader.warning:
            warning = Finding("bag", Level.WARNING, self._reader.warning, "whole", "record again, or repair it")
            self._findings.append(warning)
        self._read(progress)
        pairs = self._pairs()
        topics = self._topics
        return StereoSetup(
            str(self._reader.path),
            self._record("left", topics.left_image, topics.left_info),
            self._record("right", topics.right_image, topics.right_info),
            pairs,
            topics.rectified,
            tuple(self._findings),
        )

    def _read(self, progress: Callable[[int, int], None]) -> None:
        wanted = [*self._images, *self._infos]
        total = sum(self._reader.topics[topic].count for topic in wanted)
        for number, message in enumerate(self._reader.messages(wanted), start=1):
            try:
                stamp_ns = cdr_stamp_ns(message.data)
            except MessageError as error:
                self._findings.append(Finding.refused(f"message of {message.topic}", error))
                continue
            if message.topic in self._images:
                self._images[message.topic].append((stamp_ns, message.log_time_ns))
            else:
                self._infos[message.topic].setdefault(without_stamp(message.data), message)
            progress(number, total)

    def _record(self, side: str, image: str, info: str | None) -> CameraRecord:
        infos = []
        for message in self._infos.get(info or "", {}).values():
            try:
                infos.append(self._reader.deserialize(message))
            except MessageError as error:
                self._findings.append(Finding.refused(f"{side} camera info", error))
        return CameraRecord(image, info, [stamp_ns for stamp_ns, _ in self._images[image]], infos)

    def _pairs(self) -> list[StereoPair]:
        """Decoded pairs from all over the bag; of a camera that cannot be decoded the first error is told."""
        paired = self._paired()
        chosen = np.unique(np.linspace(0, len(paired) - 1, PAIRS_LOOKED_AT).astype(int)) if paired else ()
        pairs = []
        for index in chosen:
            frames = [self._decode(topic, *at) for topic, at in zip(self._images, paired[index], strict=True)]
            if frames[0] is not None and frames[1] is not None:
                pairs.append(StereoPair(frames[0], frames[1]))
        return pairs

    def _paired(self) -> list[tuple[tuple[int, int], tuple[int, int]]]:
        """Stamp and log time of the left and the right image of each pair."""
        pairing: StereoPairing[tuple[int, int]] = StereoPairing(NEAR)
        left, right = self._images.values()
        pairs = []
        for item, is_left in sorted([(item, True) for item in left] + [(item, False) for item in right]):
            pairs += (pairing.add_left if is_left else pairing.add_right)(item[0], item)
        return pairs + pairing.flush()

    def _decode(self, topic: str, stamp_ns: int, log_time_ns: int) -> Frame | None:
        for message in self._reader.messages([topic], log_time_ns, log_time_ns):
            if cdr_stamp_ns(message.data) != stamp_ns:
                continue
            try:
                return decode(self._reader.deserialize(message), topic)
            except MessageError as error:
                if not any(finding.check == f"images of {topic}" for finding in self._findings):
                    self._findings.append(Finding.refused(f"images of {topic}", error, f"image of {topic}"))
        return None

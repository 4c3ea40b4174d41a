# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a bag contains, whether it is usable for stereo depth, and why not."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereo_depth_ros.bags.file_infos import file_infos
from stereo_depth_ros.bags.reader import BagMessage, BagReader
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.bags.stereo_topics import CameraImages, bag_topics, info_topics
from stereo_depth_ros.bags.topics import StereoTopics
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.errors import BagError, CalibrationError, MessageError, StereoDepthError, TopicError
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.unpaired import Arrival, stamp_offset_ns, taken_together, unset_stamps
from stereo_depth_ros.messages.image import decode

__all__ = ["BagInfo", "ImageInfo", "TopicSummary", "inspect_bag"]


@dataclass(frozen=True)
class TopicSummary:
    """Message type as stored, number of messages, mean rate over the length of the bag, Hz (0 for fewer than two)."""

    msgtype: str
    count: int
    rate_hz: float


@dataclass(frozen=True)
class ImageInfo:
    """Size in pixels and encoding (for compressed images the format) of the first image of a topic."""

    width: int
    height: int
    encoding: str


@dataclass(frozen=True)
class BagInfo:
    """Result of :func:`inspect_bag`; None where it does not apply.

    Attributes:
        path: the bag.
        start_ns: log time of the first message.
        duration_s: seconds from the first message to the last one.
        topics: all topics.
        stereo: topics of the two cameras.
        left_image, right_image: the first image of each camera.
        rig: the rig of the first two camera infos.
        exact_pairs: pairs of equal stamps.
        near_pairs: pairs within ``tolerance_s``, equal stamps included.
        camera_files: the calibration files that are read instead of the camera infos of the bag.
        problems: errors, what prevents stereo depth.
        warnings: what else a user should know, a sentence each.
    """

    path: Path
    start_ns: int
    duration_s: float
    topics: dict[str, TopicSummary]
    stereo: StereoTopics | None
    left_image: ImageInfo | None
    right_image: ImageInfo | None
    rig: StereoRig | None
    exact_pairs: int
    near_pairs: int
    tolerance_s: float
    problems: tuple[StereoDepthError, ...]
    warnings: tuple[str, ...]
    camera_files: tuple[Path, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether nothing prevents stereo depth."""
        return not self.problems


def inspect_bag(
    path: Path,
    *,
    left: str | None = None,
    right: str | None = None,
    side_by_side: bool = False,
    tolerance_s: float = 0.01,
    camera_files: Sequence[Path] = (),
) -> BagInfo:
    """Examines a whole bag; only the first image of each camera is decoded.

    Args:
        path: the bag.
        left, right: image topics; None finds them.
        side_by_side: both images are in one topic, left or right.
        tolerance_s: largest difference of stamps in a near pair, seconds.
        camera_files: calibration files that are read instead of the camera infos of the bag.

    Raises:
        BagError: not a readable bag. Everything else is reported in ``problems``.
    """
    with BagReader(path) as reader:
        inspection = _Inspection(reader)
        stereo = inspection.find_topics(left, right, side_by_side)
        left_image, right_image = inspection.first_images(stereo)
        if camera_files:
            stereo, rig = inspection.read_files(stereo, camera_files)
        else:
            rig = inspection.read_rig(stereo, left_image, right_image)
        exact_pairs, near_pairs = inspection.count_pairs(stereo, tolerance_s)
        duration_s = (reader.end_ns - reader.start_ns) * 1e-9
        return BagInfo(
            path=path,
            start_ns=reader.start_ns,
            duration_s=duration_s,
            topics=_summaries(reader, duration_s),
            stereo=stereo,
            left_image=left_image,
            right_image=right_image,
            rig=rig,
            exact_pairs=exact_pairs,
            near_pairs=near_pairs,
            tolerance_s=tolerance_s,
            problems=tuple(inspection.problems),
            warnings=(reader.warning,) if reader.warning else (),
            camera_files=tuple(camera_files),
        )


class _Inspection:
    """One check per method; what is wrong is collected in ``problems``."""

    def __init__(self, reader: BagReader) -> None:
        self._reader = reader
        self.problems: list[StereoDepthError] = []

    def find_topics(self, left: str | None, right: str | None, side_by_side: bool) -> StereoTopics | None:
        try:
            return bag_topics(self._reader, left, right, side_by_side=side_by_side)
        except TopicError as error:
            self.problems.append(error)
            return None

    def first_images(self, stereo: StereoTopics | None) -> tuple[ImageInfo | None, ImageInfo | None]:
        """The first image of each camera."""
        found: list[ImageInfo | None] = [None, None]
        if stereo is None:
            return None, None
        images = CameraImages(self._reader, stereo)
        for topic in images.names:
            message = self._first_message(topic)
            if message is None:
                continue
            try:
                for side, image in images.images(message):
                    found[side] = _image_info(image, topic)
            except MessageError as error:
                self.problems.append(error)
        return found[0], found[1]

    def read_files(
        self, stereo: StereoTopics | None, files: Sequence[Path]
    ) -> tuple[StereoTopics | None, StereoRig | None]:
        """The topics with the files in place of the camera infos, and their rig."""
        if stereo is None:
            return None, None
        try:
            found = file_infos(self._reader, stereo, files)
        except (BagError, CalibrationError, MessageError) as error:
            if isinstance(error, CalibrationError) or not self.problems:  # else it is known from the images
                self.problems.append(error)
            return stereo, None
        return found.topics, found.rig

    def read_rig(
        self, stereo: StereoTopics | None, left_image: ImageInfo | None, right_image: ImageInfo | None
    ) -> StereoRig | None:
        if stereo is None:
            return None
        try:
            topics = info_topics(self._reader, stereo)
        except TopicError as error:
            self.problems.append(error)
            return None
        infos = self._first(topics[0]), self._first(topics[1])
        if None in infos:
            return None
        try:
            rig = StereoRig.from_infos(*infos, topics=topics, rectified=stereo.rectified)
            for topic, image in ((stereo.left_image, left_image), (stereo.right_image, right_image)):
                if image is not None:
                    rig.check_image(image.width, image.height, topic)
        except CalibrationError as error:
            self.problems.append(error)
            return None
        return rig

    def count_pairs(self, stereo: StereoTopics | None, tolerance_s: float) -> tuple[int, int]:
        if stereo is None:
            return 0, 0
        try:
            arrivals = self._arrivals(stereo)
        except BagError as error:
            self._add_damage(error)
            return 0, 0
        near = PairingConfig(approximate_sync=True, approximate_sync_tolerance_seconds=tolerance_s)
        exact_pairs, near_pairs = _count_pairs(arrivals, PairingConfig()), _count_pairs(arrivals, near)
        if unset := unset_stamps(arrivals, (stereo.left_image, stereo.right_image)):
            self.problems.append(unset)
        elif not exact_pairs:
            self.problems.append(_no_pairs(stereo, near_pairs, tolerance_s, arrivals))
        return exact_pairs, near_pairs

    def _arrivals(self, stereo: StereoTopics) -> list[Arrival]:
        """Side and header stamp of every image, in the order of the bag; what is lost of the camera infos shows too."""
        images, stamped = CameraImages(self._reader, stereo), StampedMessages()
        infos = {stereo.left_info, stereo.right_info} & self._reader.topics.keys()  # else they are files
        wanted = {*images.names, *(topic for topic in infos if topic is not None)}
        messages = stamped.read(message for message in self._reader.messages(wanted) if message.topic in images.names)
        arrivals = [(side, stamp_ns) for stamp_ns, message in messages for side in images.sides(message.topic)]
        if stamped.error:
            self.problems.append(stamped.error)
        return arrivals

    def _first_message(self, topic: str) -> BagMessage | None:
        try:
            message = next(self._reader.messages([topic]), None)
        except BagError as error:
            self._add_damage(error)
            return None
        if message is None:
            self.problems.append(TopicError(f"{topic} has no messages", value=0, remedy="record it again"))
        return message

    def _add_damage(self, error: BagError) -> None:
        """No message of a topic can be read; later errors count the same messages again."""
        if not any(isinstance(problem, BagError) for problem in self.problems):
            self.problems.append(error)

    def _first(self, topic: str) -> Any:
        message = self._first_message(topic)
        if message is None:
            return None
        try:
            return self._reader.deserialize(message)
        except MessageError as error:
            self.problems.append(error)
            return None


def _image_info(message: Any, topic: str) -> ImageInfo:
    height, width = decode(message, topic).pixels.shape[:2]
    return ImageInfo(width, height, getattr(message, "encoding", "") or message.format)


def _count_pairs(arrivals: Iterable[Arrival], config: PairingConfig) -> int:
    pairing: StereoPairing[None] = StereoPairing(config)
    for side, stamp_ns in arrivals:
        (pairing.add_left, pairing.add_right)[side](stamp_ns, None)
    pairing.flush()
    return pairing.counts.paired


def _no_pairs(stereo: StereoTopics, near_pairs: int, tolerance_s: float, arrivals: Sequence[Arrival]) -> TopicError:
    sides = f"no image of {stereo.left_image} has the stamp of one of {stereo.right_image}"
    if near_pairs:
        return TopicError(
            f"{sides}, but {near_pairs} pairs are within {tolerance_s:g} s",
            value=near_pairs,
            limit=tolerance_s,
            remedy=f"pair stamps that differ by up to {tolerance_s:g} s",
            settings=("approximate_sync", "approximate_sync_tolerance_seconds"),
        )
    remedy = "synchronize the cameras and record again"
    left, right = ([stamp_ns for arrived, stamp_ns in arrivals if arrived == side] for side in (0, 1))
    if offset_ns := stamp_offset_ns(left, right):
        remedy += f"; {taken_together(offset_ns)}"
    return TopicError(f"{sides}, and none is within {tolerance_s:g} s", value=0, limit=tolerance_s, remedy=remedy)


def _summaries(reader: BagReader, duration_s: float) -> dict[str, TopicSummary]:
    def rate_hz(count: int) -> float:
        return (count - 1) / duration_s if count > 1 and duration_s > 0 else 0.0

    return {
        name: TopicSummary(info.stored or info.msgtype, info.count, rate_hz(info.count))
        for name, info in reader.topics.items()
    }

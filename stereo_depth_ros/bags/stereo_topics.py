# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stereo topics of a bag: found by name, or named where one holds both images; and the halves of such images."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagMessage, BagReader
from stereo_depth_ros.bags.topics import StereoTopics, stereo_candidates
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import StereoDepthError, TopicError
from stereo_depth_ros.messages.image import image_size
from stereo_depth_ros.messages.side_by_side import WIDE, split_message

__all__ = ["CameraImages", "bag_candidates", "bag_topics", "info_topics"]


def bag_topics(
    reader: BagReader, left: str | None = None, right: str | None = None, *, side_by_side: bool = False
) -> StereoTopics:
    """The best of :func:`bag_candidates`."""
    return bag_candidates(reader, left, right, side_by_side=side_by_side)[0]


def bag_candidates(
    reader: BagReader, left: str | None = None, right: str | None = None, *, side_by_side: bool = False
) -> list[StereoTopics]:
    """The stereo pairs among the topics that have messages, by :func:`stereo_candidates`, the best first.

    Args:
        reader: the bag.
        left, right: image topics; None finds them.
        side_by_side: both images are in one topic, left or right names it.

    Raises:
        TopicError: no pair, several equally good ones, or names that are not those of two images. Where a topic looks
            like both images side by side, it is named with the remedy.
    """
    filled = {name: info.msgtype for name, info in reader.topics.items() if info.count or name in (left, right)}
    try:
        try:
            return stereo_candidates(filled, left, right, side_by_side=side_by_side)
        except TopicError:
            if len(filled) == len(reader.topics):
                raise
            return stereo_candidates(reader.msgtypes, left, right, side_by_side=side_by_side)
    except TopicError as error:
        wide = _joint_topics(reader, left or right)
        if side_by_side and left is None and right is None:
            found = [topics for topics, _ in wide]
            if len(found) == 1:
                return found
        hint = None if side_by_side else next((_look_like_two(*each) for each in wide), None)
        raise (hint or error).about(reader.path) from error


def info_topics(reader: BagReader, topics: StereoTopics) -> tuple[str, str]:
    """The camera infos of both cameras.

    Raises:
        TopicError: a camera without one.
    """
    if topics.left_info is not None and topics.right_info is not None:
        return topics.left_info, topics.right_info
    missing = topics.left_image if topics.left_info is None else topics.right_image
    raise TopicError(
        f"no CameraInfo topic belongs to {missing}, topics of the bag are {', '.join(reader.topics)}",
        subject=str(reader.path),
        value=missing,
        remedy="record the camera infos too, or give calibration files",
        settings=("camera_info",),
    )


def _joint_topics(reader: BagReader, named: str | None) -> Iterator[tuple[StereoTopics, str]]:
    """The topics whose images look like two side by side, and why."""
    for name in reader.topics if named is None else (named,):
        try:
            (topics,) = stereo_candidates(reader.msgtypes, name, name, side_by_side=True)
        except TopicError:  # no image
            continue
        if looks := _looks_like_two(reader, topics):
            yield topics, looks


def _look_like_two(topics: StereoTopics, looks: str) -> TopicError:
    return TopicError(
        f"{topics.left_image} looks like both images side by side, {looks}",
        value=topics.left_image,
        remedy="read both from it",
        settings=("side_by_side",),
    )


def _looks_like_two(reader: BagReader, topics: StereoTopics) -> str:
    """Why an image looks like two; empty where it does not, or where it cannot be read."""
    try:
        image = _first(reader, topics.left_image)
        if image is None:
            return ""
        width, height = image_size(image, topics.left_image)
        info = _first(reader, topics.left_info)
        camera = None if info is None else camera_from_info(info)
    except StereoDepthError:
        return ""
    if camera is not None and camera.calibrated:
        if (width, height) != (2 * camera.width, camera.height):
            return ""
        return f"{width}x{height} where the camera infos are for {camera.width}x{camera.height}"
    return f"{width}x{height}" if width >= WIDE * height else ""


def _first(reader: BagReader, topic: str | None) -> Any:
    message = None if topic is None else next(reader.messages([topic]), None)
    return None if message is None else reader.deserialize(message)


def _frame(reader: BagReader, topic: str | None) -> str:
    """The frame of the first camera info; empty where it cannot be read."""
    try:
        info = _first(reader, topic)
    except StereoDepthError:
        return ""
    return "" if info is None else str(info.header.frame_id)


class CameraImages:
    """The images of both cameras in the messages of a bag: one each, or both halves of images side by side.

    Args:
        reader: the bag.
        topics: of both cameras.

    Attributes:
        names: of the image topics; the same for both sides where they are side by side.
    """

    def __init__(self, reader: BagReader, topics: StereoTopics) -> None:
        self._reader = reader
        self._types = RosbagsTypes()
        self._topics = topics
        self.names = list(dict.fromkeys((topics.left_image, topics.right_image)))
        self._frames = ("", "")
        if topics.side_by_side:
            self._frames = _frame(reader, topics.left_info), _frame(reader, topics.right_info)

    def sides(self, topic: str) -> tuple[int, ...]:
        """Sides whose images are in the messages of one of the topics, 0 left and 1 right."""
        return (0, 1) if self._topics.side_by_side else (int(topic != self._topics.left_image),)

    def of(self, message: BagMessage) -> Iterator[tuple[int, bytes]]:
        """Side, 0 left and 1 right, and CDR bytes of each image in a message, of :attr:`StereoTopics.image_type`.

        Raises:
            MessageError: an image that cannot be split; only of those side by side.
        """
        if not self._topics.side_by_side:
            yield self.sides(message.topic)[0], message.data
            return
        for side, half in self.images(message):
            yield side, self._types.serialize(half)

    def images(self, message: BagMessage) -> Iterator[tuple[int, Any]]:
        """As :meth:`of`, with the messages of the images in place of their bytes.

        Raises:
            MessageError: bytes that are not an image, or an image that cannot be split.
        """
        whole = self._reader.deserialize(message)
        if not self._topics.side_by_side:
            yield self.sides(message.topic)[0], whole
            return
        frame = whole.header.frame_id
        frames = self._frames[0] or frame, self._frames[1] or (f"{frame}_right" if frame else "")
        yield from enumerate(split_message(self._types, whole, message.topic, frames))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Finds the image topics of a stereo pair and their camera infos by name."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from stereo_depth_ros.core.errors import TopicError

__all__ = ["INFO_TYPE", "StereoTopics", "find_stereo_topics"]

INFO_TYPE = "sensor_msgs/msg/CameraInfo"
_RAW = "sensor_msgs/msg/Image"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_VIDEO = {"CompressedVideo", "FFMPEGPacket"}  # message types of foxglove and ffmpeg_image_transport
_NO_IMAGES = "record sensor_msgs/Image or CompressedImage of both cameras"
_REMEDY = "name both image topics"
_VIDEO_REMEDY = "decode it by ros2 run image_transport republish, and use the raw or compressed topics"
_SETTINGS = ("left", "right")

# words of a name: leftImage2 is left, Image, 2
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|\d+|[^A-Za-z\d]+")
_RECTIFIED = {"rect", "rectified", "undistorted", "undist"}
_COLOR = re.compile(r"colou?r|rgb|bgr")


@dataclass(frozen=True)
class StereoTopics:
    """Topics of one stereo rig; a camera info topic is None where there is none.

    Attributes:
        compressed: the images are sensor_msgs/CompressedImage.
        rectified: the topic names state that the images are rectified.
    """

    left_image: str
    right_image: str
    left_info: str | None
    right_info: str | None
    compressed: bool
    rectified: bool

    @property
    def image_type(self) -> str:
        """Message type of both images."""
        return _COMPRESSED if self.compressed else _RAW


def find_stereo_topics(topics: Mapping[str, str], left: str | None = None, right: str | None = None) -> StereoTopics:
    """The stereo pair among ``topics``.

    Two image topics of one type are a pair when their names differ only in the camera name: left and right,
    l and r, or numbers n and n + 1. Of several pairs one with camera infos is preferred, then raw over rectified, gray
    over color, uncompressed over compressed.

    Args:
        topics: message type per topic name.
        left, right: image topics; None finds them.

    Raises:
        TopicError: no pair, several equally good ones, equal names, or a name that is missing or not of an image.
    """
    if left is not None and left == right:
        raise TopicError(
            f"left and right are the same topic {left}",
            value=left,
            remedy="name one topic per camera",
            settings=_SETTINGS,
        )
    images = {name: kind for name, kind in topics.items() if kind in (_RAW, _COMPRESSED)}
    for name in (left, right):
        _check_image(name, topics, images)
    if left is not None and right is not None:
        return _checked_pair(left, right, topics)
    candidates = [
        _stereo_topics(one, other, topics)
        for one, other in _side_pairs(images)
        if images[one] == images[other] and left in (None, one) and right in (None, other)
    ]
    if not candidates:
        _refuse_video(topics)
    return _best(candidates, images, left or right)


def _check_image(name: str | None, topics: Mapping[str, str], images: Mapping[str, str]) -> None:
    if name is None or name in images:
        return
    problem = f"topic {name} is {topics[name]}, not an image" if name in topics else f"no topic {name}"
    remedy = f"choose among the image topics {', '.join(sorted(images))}" if images else _NO_IMAGES
    if _is_video(topics.get(name, "")):
        remedy = _VIDEO_REMEDY
    raise TopicError(problem, value=name, limit=sorted(images), remedy=remedy, settings=_SETTINGS)


def _is_video(kind: str) -> bool:
    return re.split(r"[/.]", kind)[-1] in _VIDEO


def _refuse_video(topics: Mapping[str, str]) -> None:
    """Raise TopicError where the images may be in topics of video."""
    video = {name: kind for name, kind in sorted(topics.items()) if _is_video(kind)}
    if video:
        raise TopicError(
            f"{', '.join(video)} {'are' if len(video) > 1 else 'is'} video ({', '.join(sorted(set(video.values())))}), "
            "H.264 or H.265, whose images need those before them",
            value=list(video),
            limit=(_RAW, _COMPRESSED),
            remedy=_VIDEO_REMEDY,
            settings=_SETTINGS,
        )


def _checked_pair(left: str, right: str, topics: Mapping[str, str]) -> StereoTopics:
    if topics[left] != topics[right]:
        raise TopicError(
            f"left {left} is {topics[left]} and right {right} is {topics[right]}",
            value=(topics[left], topics[right]),
            remedy="choose two topics of one type",
            settings=_SETTINGS,
        )
    return _stereo_topics(left, right, topics)


def _best(candidates: list[StereoTopics], images: Mapping[str, str], given: str | None) -> StereoTopics:
    ranked = sorted(candidates, key=_rank)
    if not ranked:
        wanted = f"no partner for {given}" if given else "no stereo pair"
        raise TopicError(
            f"{wanted} among the image topics {', '.join(sorted(images))}" if images else "no image topics",
            value=sorted(images),
            remedy=_REMEDY if images else _NO_IMAGES,
            settings=_SETTINGS,
        )
    equal = [pair for pair in ranked if _rank(pair) == _rank(ranked[0])]
    if len(equal) > 1:
        pairs = "; ".join(f"{pair.left_image} with {pair.right_image}" for pair in equal)
        raise TopicError(
            f"{len(equal)} stereo pairs are equally good ({pairs})",
            value=len(equal),
            limit=1,
            remedy=_REMEDY,
            settings=_SETTINGS,
        )
    return ranked[0]


def _rank(pair: StereoTopics) -> tuple[bool, bool, bool, bool]:
    color = any(_COLOR.fullmatch(word) for word in _words(pair.left_image))
    return (pair.left_info is None or pair.right_info is None, pair.rectified, color, pair.compressed)


def _stereo_topics(left: str, right: str, topics: Mapping[str, str]) -> StereoTopics:
    left_info, right_info = _infos(left, right, topics)
    return StereoTopics(
        left_image=left,
        right_image=right,
        left_info=left_info,
        right_info=right_info,
        compressed=topics[left] == _COMPRESSED,
        rectified=bool(_RECTIFIED & set(_words(left))),
    )


def _infos(left: str, right: str, topics: Mapping[str, str]) -> tuple[str | None, str | None]:
    """The siblings of the images, or else the pair of camera infos that shares most leading words with the images.

    The sibling of another image is not used: the calibration of another camera would give plausible but wrong depth.
    """
    infos = [name for name, kind in topics.items() if kind == INFO_TYPE]
    siblings = _sibling(left, infos), _sibling(right, infos)
    if None not in siblings and siblings[0] != siblings[1]:
        return siblings

    def similarity(pair: tuple[str, str]) -> int:
        return _common_words(pair[0], left) + _common_words(pair[1], right)

    siblings_of_images = {_sibling(name, infos) for name, kind in topics.items() if kind in (_RAW, _COMPRESSED)}
    pairs = sorted(_side_pairs(set(infos) - siblings_of_images), key=similarity, reverse=True)
    if pairs and (len(pairs) == 1 or similarity(pairs[0]) > similarity(pairs[1])):
        return pairs[0]
    return None, None


def _sibling(image: str, infos: list[str]) -> str | None:
    """``camera_info`` in the namespace of the image; of a compressed topic also in that of its base topic."""
    namespace = image.rpartition("/")[0]
    for parent in (namespace, namespace.rpartition("/")[0]):
        if f"{parent}/camera_info" in infos:
            return f"{parent}/camera_info"
    return None


def _side_pairs(names: Iterable[str]) -> list[tuple[str, str]]:
    return [pair for pair in itertools.permutations(sorted(names), 2) if _is_side_pair(*pair)]


def _is_side_pair(left: str, right: str) -> bool:
    left_words, right_words = _words(left), _words(right)
    if len(left_words) != len(right_words):
        return False
    different = [(a, b) for a, b in zip(left_words, right_words, strict=True) if a != b]
    return bool(different) and all(_are_sides(a, b) for a, b in different)


def _are_sides(left: str, right: str) -> bool:
    if left.isdigit() and right.isdigit():
        return int(right) == int(left) + 1
    return (left, right) == ("l", "r") or ("left" in left and left.replace("left", "right") == right)


def _common_words(one: str, other: str) -> int:
    pairs = zip(_words(one), _words(other), strict=False)
    return sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs))


def _words(name: str) -> list[str]:
    return [word.lower() for word in _WORD.findall(name)]

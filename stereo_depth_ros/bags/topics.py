# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Finds the image topics of a stereo pair and their camera infos by name."""

from __future__ import annotations

import enum
import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stereo_depth_ros.core.errors import TopicError

__all__ = ["INFO_TYPE", "StereoTopics", "find_stereo_topics", "stereo_candidates"]

INFO_TYPE = "sensor_msgs/msg/CameraInfo"
_RAW = "sensor_msgs/msg/Image"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_VIDEO = {"CompressedVideo", "FFMPEGPacket"}  # message types of foxglove and ffmpeg_image_transport
_NO_IMAGES = "record sensor_msgs/Image or CompressedImage of both cameras"
_THEORA = "theora_image_transport/msg/Packet"
_UNREADABLE = {"compressedDepth": "a compressed depth image", "zstd": "compressed by zstd"}  # names of image_transport
_REMEDY = "name both image topics"
_DECODE_REMEDY = "decode it by ros2 run image_transport republish, and use the raw or compressed topics"
_SETTINGS = ("left", "right")

# words of a name: leftImage2 is left, Image, 2
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|\d+|[^A-Za-z\d]+")
_RECTIFIED = {"rect", "rectified", "undistorted", "undist"}
_COLOR = re.compile(r"colou?r|rgb|bgr")
# what drivers and simulators publish beside the images of a camera, as images too
_NO_PHOTO = {"depth", "disparity", "confidence", "semantic", "segmentation", "instance", "mask", "labels", "normals"}
_SIDES = {"left", "right", "l", "r"}


class _Kind(enum.Enum):
    """What the name of an image or camera info says about rectification."""

    RAW = enum.auto()
    RECTIFIED = enum.auto()
    PLAIN = enum.auto()


# Kinds of camera infos that an image of a kind may have, the best first. Raw images with the camera infos of rectified
# ones would be left as they are; of rectified ones only P counts, which those of the raw camera have too.
_INFO_KINDS = {
    _Kind.RAW: (_Kind.RAW, _Kind.PLAIN),
    _Kind.RECTIFIED: (_Kind.RECTIFIED, _Kind.PLAIN, _Kind.RAW),
    _Kind.PLAIN: (_Kind.PLAIN, _Kind.RAW, _Kind.RECTIFIED),
}


@dataclass(frozen=True)
class StereoTopics:
    """Topics of one stereo rig; a camera info topic is None where there is none.

    Attributes:
        compressed: the images are sensor_msgs/CompressedImage.
        rectified: the topic names state that the images are rectified.
        side_by_side: both images are in one topic, left_image and right_image alike. Its halves are raw images, so
            that ``compressed`` is false.
    """

    left_image: str
    right_image: str
    left_info: str | None
    right_info: str | None
    compressed: bool
    rectified: bool
    side_by_side: bool = False

    @property
    def image_type(self) -> str:
        """Message type of both images."""
        return _COMPRESSED if self.compressed else _RAW

    @property
    def certainty(self) -> tuple[bool, int]:
        """How surely the names are those of two cameras, smaller is surer."""
        words = list(zip(_words(self.left_image), _words(self.right_image), strict=False))
        numbers = sum(a != b and a.isdigit() for a, b in words)
        if self.side_by_side:
            numbers = len(_SIDES.intersection(_words(self.left_image)))
        return not _NO_PHOTO.isdisjoint(_words(_last(self.left_image, 2))), numbers

    @property
    def rank(self) -> tuple[Any, ...]:
        """Order of preference, smaller is better; equal ones are equally good."""
        color = any(_COLOR.fullmatch(word) for word in _words(self.left_image))
        lacks_info = self.left_info is None or self.right_info is None
        named_raw = _kind(self.left_image) is _Kind.RAW
        no_photo, numbers = self.certainty
        packed = self.compressed or _last(self.left_image, 1) == "compressed"
        return no_photo, lacks_info, numbers, self.rectified, color, packed, not named_raw


def find_stereo_topics(
    topics: Mapping[str, str], left: str | None = None, right: str | None = None, *, side_by_side: bool = False
) -> StereoTopics:
    """The best of :func:`stereo_candidates`."""
    return stereo_candidates(topics, left, right, side_by_side=side_by_side)[0]


def stereo_candidates(
    topics: Mapping[str, str], left: str | None = None, right: str | None = None, *, side_by_side: bool = False
) -> list[StereoTopics]:
    """The stereo pairs among ``topics``, the best first.

    Two image topics of one type are a pair when their names differ only in the camera name: left and right,
    l and r, or numbers n and n + 1. A pair with camera infos is preferred, then left and right over numbers, raw over
    rectified, gray over color, uncompressed over compressed, image_raw over others. Depth images and the like come
    last. Camera infos are those of the kind of the image: image_raw has camera_info_raw or else camera_info,
    image_rect has camera_info_rect or else camera_info.

    Args:
        topics: message type per topic name.
        left, right: image topics; None finds them.
        side_by_side: both images are in one topic, left or right names it.

    Returns:
        At least one; one where both are given. The first one is the only one of its rank.

    Raises:
        TopicError: no pair, several equally good ones, equal names, or a name that is missing or not of an image.
    """
    if left is not None and left == right and not side_by_side:
        raise TopicError(
            f"left and right are the same topic {left}",
            value=left,
            remedy="name one topic per camera",
            settings=_SETTINGS,
        )
    images = {name: kind for name, kind in topics.items() if kind in (_RAW, _COMPRESSED)}
    for name in (left, right):
        _check_image(name, topics, images)
    if side_by_side:
        return _side_by_side(topics, images, left, right)
    if left is not None and right is not None:
        return [_checked_pair(left, right, topics)]
    readable = [name for name in images if not _why_unreadable(name, images[name]) or name in (left, right)]
    candidates = [
        _stereo_topics(one, other, topics)
        for one, other in _side_pairs(readable)
        if images[one] == images[other] and left in (None, one) and right in (None, other)
    ]
    if not candidates:
        _refuse_unreadable(topics)
    return _ranked(candidates, images, left or right)


def _side_by_side(
    topics: Mapping[str, str], images: Mapping[str, str], left: str | None, right: str | None
) -> list[StereoTopics]:
    """The topics that may hold both images, the best first."""
    named = left or right
    if left is not None and right is not None and left != right:
        raise TopicError(
            f"left {left} and right {right} are two topics, side by side is one with both images",
            value=(left, right),
            limit=1,
            remedy="name one topic, or read them without the option",
            settings=("side_by_side", *_SETTINGS),
        )
    readable = [name for name, kind in images.items() if not _why_unreadable(name, kind)]
    of_pairs = {name for pair in _side_pairs(readable) for name in pair if images[pair[0]] == images[pair[1]]}
    names = [named] if named else sorted(set(readable) - of_pairs)
    if not names and images:
        pairs = f": {', '.join(sorted(of_pairs))} are of one camera each" * bool(of_pairs)
        raise TopicError(
            f"no topic holds both images side by side among the image topics {', '.join(sorted(images))}{pairs}",
            value=sorted(images),
            remedy="read them without the option, or name the topic",
            settings=("side_by_side", "left"),
        )
    return _ranked([_joint(name, topics) for name in names], images, named)


def _joint(image: str, topics: Mapping[str, str]) -> StereoTopics:
    """One topic with both images, and the camera infos of two that share most leading words with it."""
    infos = [name for name, kind in topics.items() if kind == INFO_TYPE]
    kinds = _INFO_KINDS[_kind(image)]
    pairs = _side_pairs(name for name in infos if _kind(name) in kinds)
    left_info, right_info = _nearest_pair(pairs, image, image, kinds) or (None, None)
    rectified = _kind(image) is _Kind.RECTIFIED
    return StereoTopics(image, image, left_info, right_info, False, rectified, side_by_side=True)


def _check_image(name: str | None, topics: Mapping[str, str], images: Mapping[str, str]) -> None:
    if name is None or name in images:
        return
    problem = f"topic {name} is {topics[name]}, not an image" if name in topics else f"no topic {name}"
    remedy = f"choose among the image topics {', '.join(sorted(images))}" if images else _NO_IMAGES
    if _why_unreadable(name, topics.get(name, "")):
        remedy = _DECODE_REMEDY
    raise TopicError(problem, value=name, limit=sorted(images), remedy=remedy, settings=_SETTINGS)


def _why_unreadable(name: str, kind: str) -> str:
    """What is in a topic whose images cannot be read; empty for others."""
    if re.split(r"[/.]", kind)[-1] in _VIDEO:
        return f"video ({kind}), H.264 or H.265, whose images need those before them"
    if kind == _THEORA:
        return f"video ({kind}), whose images need those before them"
    return _UNREADABLE.get(_last(name, 1), "") if kind == _COMPRESSED else ""


def _refuse_unreadable(topics: Mapping[str, str]) -> None:
    """Raise TopicError where the images may be in topics that cannot be read."""
    found: dict[str, list[str]] = {}
    for name, kind in sorted(topics.items()):
        if why := _why_unreadable(name, kind):
            found.setdefault(why, []).append(name)
    if found:
        raise TopicError(
            "; ".join(f"{', '.join(names)} {'are' if len(names) > 1 else 'is'} {why}" for why, names in found.items()),
            value=[name for names in found.values() for name in names],
            limit=(_RAW, _COMPRESSED),
            remedy=_DECODE_REMEDY,
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


def _ranked(candidates: list[StereoTopics], images: Mapping[str, str], given: str | None) -> list[StereoTopics]:
    ranked = sorted(candidates, key=lambda pair: pair.rank)
    if not ranked:
        wanted = f"no partner for {given}" if given else "no stereo pair"
        raise TopicError(
            f"{wanted} among the image topics {', '.join(sorted(images))}" if images else "no image topics",
            value=sorted(images),
            remedy=_REMEDY if images else _NO_IMAGES,
            settings=_SETTINGS,
        )
    equal = [pair for pair in ranked if pair.rank == ranked[0].rank]
    if len(equal) > 1:
        both = ranked[0].side_by_side
        pairs = "; ".join(pair.left_image if both else f"{pair.left_image} with {pair.right_image}" for pair in equal)
        raise TopicError(
            f"{len(equal)} {'topics' if both else 'stereo pairs'} are equally good ({pairs})",
            value=len(equal),
            limit=1,
            remedy="name the topic" if both else _REMEDY,
            settings=_SETTINGS,
        )
    return ranked


def _stereo_topics(left: str, right: str, topics: Mapping[str, str]) -> StereoTopics:
    left_info, right_info = _infos(left, right, topics)
    return StereoTopics(
        left_image=left,
        right_image=right,
        left_info=left_info,
        right_info=right_info,
        compressed=topics[left] == _COMPRESSED,
        rectified=_kind(left) is _Kind.RECTIFIED,
    )


def _infos(left: str, right: str, topics: Mapping[str, str]) -> tuple[str | None, str | None]:
    """The siblings of the images, or else the pair of camera infos that shares most leading words with the images.

    The sibling of another image is not used: the calibration of another camera would give plausible but wrong depth.
    """
    infos = [name for name, kind in topics.items() if kind == INFO_TYPE]
    kinds = _INFO_KINDS[_kind(left)]
    for kind in kinds:
        siblings = _sibling(left, topics, kind), _sibling(right, topics, kind)
        if None not in siblings and siblings[0] != siblings[1]:
            return siblings

    images = [name for name, kind in topics.items() if kind in (_RAW, _COMPRESSED)]
    of_images = {_sibling(name, topics, kind) for name in images for kind in _Kind}
    pairs = [pair for pair in _side_pairs(set(infos) - of_images) if _kind(pair[0]) in kinds]
    return _nearest_pair(pairs, left, right, kinds) or (None, None)


def _nearest_pair(
    pairs: Iterable[tuple[str, str]], left: str, right: str, kinds: Sequence[_Kind]
) -> tuple[str, str] | None:
    """The camera infos that share most leading words with the images, then those of the better kind; None for a tie."""

    def order(pair: tuple[str, str]) -> tuple[int, int]:
        return -_common_words(pair[0], left) - _common_words(pair[1], right), kinds.index(_kind(pair[0]))

    ranked = sorted(pairs, key=order)
    return ranked[0] if len(ranked) == 1 or (ranked and order(ranked[0]) < order(ranked[1])) else None


def _sibling(image: str, topics: Mapping[str, str], kind: _Kind) -> str | None:
    """``camera_info``, or camera_info_raw or camera_info_rect, in the namespace of the image or below the image.

    The image of a compressed topic is its base topic.
    """
    base = image.rpartition("/")[0]
    places = (base, base.rpartition("/")[0]) if topics[image] == _COMPRESSED else (image, base)
    for place in places:
        for name, type_ in topics.items():
            if type_ == INFO_TYPE and name.rpartition("/")[0] == place and _info_kind(_last(name, 1)) is kind:
                return name
    return None


def _info_kind(name: str) -> _Kind | None:
    """The kind of camera_info, camera_info_raw and the like; None for other names, such as camera_info_left."""
    words = [word for word in _words(name) if word[0].isalnum()]
    others = [word for word in words if word not in _RECTIFIED | {"raw"}]
    return _kind(name) if others == ["camera", "info"] else None


def _kind(name: str) -> _Kind:
    words = set(_words(name))
    if _RECTIFIED & words:
        return _Kind.RECTIFIED
    return _Kind.RAW if "raw" in words else _Kind.PLAIN


def _last(name: str, parts: int) -> str:
    """The last parts of a name."""
    return "/".join(name.split("/")[-parts:])


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

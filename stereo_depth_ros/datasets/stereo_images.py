# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image pairs for calibration: image files of a folder, or the raw images of a bag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files, is_bag
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.bags.stereo_topics import CameraImages, bag_candidates
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import BagError, MessageError, TopicError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.core.types import U8, Frame
from stereo_depth_ros.datasets.image_files import read_pair
from stereo_depth_ros.datasets.image_pairs import find_image_pairs
from stereo_depth_ros.messages.cdr import cdr_stamp_ns
from stereo_depth_ros.messages.image import decode_pair

__all__ = ["BagImages", "FolderImages", "ImagePair", "StereoImages", "open_stereo_images"]

_SETTINGS = ("left", "right")
_TOLERANCE_S = 0.005  # for cameras with one trigger and two clocks


@dataclass(frozen=True)
class ImagePair:
    """Images of both cameras, uint8 (H, W) gray, not necessarily of one size, and a name for messages to the user."""

    name: str
    left: U8
    right: U8


class StereoImages(Protocol):
    """Pairs of images.

    Attributes:
        warnings: a sentence for everything else that was skipped; final when all pairs have been read.
        unreadable: a sentence for each pair with an image that cannot be read; final as those.
        dense: whether the pairs are a recording, in which successive images are similar.
        files: all files that are read.
    """

    warnings: list[str]
    unreadable: list[str]
    dense: bool
    files: list[Path]

    def __len__(self) -> int:
        """Number of pairs, or an upper bound."""

    def __iter__(self) -> Iterator[ImagePair]:
        """The pairs in order."""


def open_stereo_images(
    place: Path, left: str | None = None, right: str | None = None, *, side_by_side: bool = False
) -> StereoImages:
    """The pairs of a bag or of a folder.

    Args:
        place: a bag, or a folder of image files.
        left, right: image topics of the bag, or patterns of file names in the folder; None finds them.
        side_by_side: both images are in one topic, or in one file.

    Raises:
        BagError, TopicError: nothing there, or no pairs in it.
    """
    if not place.exists():
        raise BagError("does not exist", subject=str(place), remedy="name a folder of images, or a bag")
    if place.is_file() or is_bag(place):
        return BagImages(place, left, right, side_by_side=side_by_side)
    return FolderImages(place, left, right, side_by_side=side_by_side)


class FolderImages:
    """Image files in a folder or below it, paired by :func:`find_image_pairs`.

    Args:
        folder: holds the images.
        left, right: patterns such as "a/*.png" and "b/*.png", or one for both, see :func:`find_image_pairs`; None uses
            the words for the cameras.
        side_by_side: each file holds both images.

    Raises:
        BagError: see :func:`find_image_pairs`.
    """

    dense = False

    def __init__(
        self, folder: Path, left: str | None = None, right: str | None = None, *, side_by_side: bool = False
    ) -> None:
        try:
            found = find_image_pairs(folder, left, right, side_by_side=side_by_side)
        except BagError as error:
            if left is not None or right is not None or "side_by_side" in error.settings:
                raise
            raise BagError(
                error.problem,
                subject=error.subject,
                value=error.value,
                remedy=f"{error.remedy}, or give patterns for both cameras",
                settings=_SETTINGS,
            ) from error
        self._pairs, self.warnings = found.pairs, found.warnings
        self.unreadable: list[str] = []
        self.files = [path for pair in self._pairs for path in pair]

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[ImagePair]:
        self.unreadable.clear()
        for left, right in self._pairs:
            try:
                one, other = read_pair(left, right)
            except BagError as error:
                self.unreadable.append(f"{error.subject}: skipped, it {error.problem}")
            else:
                yield ImagePair(left.name, _gray(one), _gray(other))


def _gray(pixels: U8) -> U8:
    return to_gray(Frame(pixels, 0, "", "mono8" if pixels.ndim == 2 else "bgr8"))


class BagImages:
    """The raw images of a bag, paired by stamps that differ by up to 5 ms; camera infos are not needed.

    Args:
        path: the bag.
        left, right: image topics; None finds them.
        side_by_side: both images are in one topic, left or right.

    Raises:
        BagError, TopicError: no bag, or no stereo pair in it.
    """

    dense = True

    def __init__(
        self, path: Path, left: str | None = None, right: str | None = None, *, side_by_side: bool = False
    ) -> None:
        self._path = path
        self._types = RosbagsTypes()
        self.files = bag_files(path)
        self.unreadable: list[str] = []
        self.warnings: list[str] = []  # those known when all pairs are read
        with BagReader(path) as reader:
            found = bag_candidates(reader, left, right, side_by_side=side_by_side)
            self._topics = next((topics for topics in found if not topics.rectified), found[0])
            self._count = reader.topics[self._topics.left_image].count
        if self._topics.rectified:
            raise TopicError(
                f"{self._topics.left_image} is rectified already",
                subject=str(path),
                value=self._topics.left_image,
                remedy="calibrate with raw images: record the topics before rectification, or name them",
                settings=_SETTINGS,
            )

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[ImagePair]:
        config = PairingConfig(approximate_sync=True, approximate_sync_tolerance_seconds=_TOLERANCE_S)
        pairing: StereoPairing[bytes] = StereoPairing(config)
        depth = BitDepth()
        self.unreadable.clear()
        with BagReader(self._path) as reader:
            images, stamped = CameraImages(reader, self._topics), StampedMessages()
            for stamp_ns, message in stamped.read(reader.messages(images.names)):
                for side, data in images.of(message):
                    for pair in (pairing.add_left, pairing.add_right)[side](stamp_ns, data):
                        yield from self._decoded(*pair, depth)
            for pair in pairing.flush():
                yield from self._decoded(*pair, depth)
            if reader.warning:
                self.warnings.append(reader.warning)
        lost = pairing.counts.dropped_left + pairing.counts.dropped_right
        if stamped.error:
            self.warnings.append(f"{self._path}: {stamped.error}")
        if lost:
            self.warnings.append(f"{self._path}: {lost} images have no partner within {1e3 * _TOLERANCE_S:g} ms")

    def _decoded(self, left: bytes, right: bytes, depth: BitDepth) -> Iterator[ImagePair]:
        """The pair; nothing, and a sentence, where an image cannot be decoded."""
        name = f"{cdr_stamp_ns(left) / 1e9:.3f} s"
        try:
            one, other = (self._types.deserialize(data, self._topics.image_type) for data in (left, right))
            pair = decode_pair(one, other, (self._topics.left_image, self._topics.right_image), depth)
        except MessageError as error:
            self.unreadable.append(f"{name}: skipped, {error.subject}: {error.problem}")
        else:
            yield ImagePair(name, to_gray(pair.left), to_gray(pair.right))

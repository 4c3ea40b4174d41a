# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Captures of projected patterns, of a bag or of a folder of images, and the sequences among them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from stereo_depth_ros.active.scanner import Capture, by_changes, settling
from stereo_depth_ros.active.shown_patterns import ShownPatterns
from stereo_depth_ros.active.structured_light.collecting import AnnouncedPatterns, ChangingPatterns
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files, is_bag
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.camera_files.reading import read_rig_files, rig_file_paths
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import BagError, CalibrationError, ImageError, TopicError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.datasets.image_files import framed, image_frame, read_image, read_pair
from stereo_depth_ros.datasets.image_pairs import find_image_pairs
from stereo_depth_ros.datasets.numbered_images import numbered_images
from stereo_depth_ros.messages.image import decode
from stereo_depth_ros.offline.pairs import read_pairs

__all__ = ["CaptureSource", "find_sequences"]

Captured: TypeAlias = "tuple[Capture, StereoRig]"

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_ANNOUNCEMENT = ("scan/shown", "std_msgs/msg/Int32")
_NAMED = 3  # patterns named in one error
_STEP_NS = 10**9  # between the images of a folder, which have no stamps


@dataclass(frozen=True)
class CaptureSource:
    """Where captures are read from.

    Attributes:
        selection: a bag, or the path of a folder of images; ``left`` and ``right`` are topics, or patterns of files.
        projector: the right camera of the rig is the projector, and only the left one has images.
    """

    selection: BagSelection
    projector: bool = False

    @property
    def files(self) -> list[Path]:
        """The files that are read, as far as they are known before."""
        path = self.selection.path
        own = bag_files(path) if is_bag(path) else [each for pair in self._image_files() for each in pair]
        return [*own, *rig_file_paths(self.selection.camera_files)] if self.selection.camera_files else own

    def read(self) -> Iterator[Captured]:
        """The captures with their rig, in the order of their stamps or of the names of their files.

        Raises:
            BagError, TopicError: no such bag or images.
            CalibrationError: no rig, or not that of the images.
            MessageError: an image that cannot be decoded.
        """
        chosen = self.selection
        if is_bag(chosen.path):
            if self.projector:
                return self._of_topic()
            pairs = read_pairs(
                chosen.path,
                chosen.left,
                chosen.right,
                side_by_side=chosen.side_by_side,
                camera_files=chosen.camera_files,
            )
            return (((pair.left, pair.right), rig) for pair, rig in pairs)
        return self._of_folder()

    def announcements(self) -> list[tuple[int, int]]:
        """Log time, nanoseconds, and number of each announced pattern of a bag; empty where none is."""
        if not is_bag(self.selection.path):
            return []
        with BagReader(self.selection.path) as reader:
            name, msgtype = _ANNOUNCEMENT
            topics = [topic for topic, kind in reader.msgtypes.items() if kind == msgtype and topic.endswith(name)]
            if not topics:
                return []
            return [(each.log_time_ns, int(reader.deserialize(each).data)) for each in reader.messages(topics[:1])]

    def _rig(self) -> StereoRig:
        if not self.selection.camera_files:
            what = "the camera and the projector" if self.projector else "both cameras"
            raise CalibrationError(
                f"no calibration of {what} is given",
                subject=str(self.selection.path),
                remedy="give calibration files",
                settings=("camera_info",),
            )
        return framed(read_rig_files(self.selection.camera_files))

    def _of_topic(self) -> Iterator[Captured]:
        rig, depth, stamped = self._rig(), BitDepth(), StampedMessages()
        with BagReader(self.selection.path) as reader:
            topic = self.selection.left or _only_images(reader)
            for _, message in stamped.read(reader.messages([topic])):
                yield (decode(reader.deserialize(message), topic, depth),), rig
        if stamped.error:
            raise stamped.error

    def _of_folder(self) -> Iterator[Captured]:
        rig = self._rig()
        for number, paths in enumerate(self._image_files(), start=1):
            stamp_ns = number * _STEP_NS
            pixels = (read_image(paths[0]),) if len(paths) == 1 else read_pair(*paths)
            yield (
                tuple(
                    image_frame(each, camera, stamp_ns)
                    for each, camera in zip(pixels, (rig.left, rig.right), strict=False)
                ),
                rig,
            )

    def _image_files(self) -> Sequence[tuple[Path, ...]]:
        chosen = self.selection
        if not chosen.path.is_dir():
            raise BagError("is neither a bag nor a folder", subject=str(chosen.path), remedy="check the path")
        if self.projector:
            return [(path,) for path in numbered_images([chosen.path], chosen.left or "*")]
        return find_image_pairs(chosen.path, chosen.left, chosen.right, side_by_side=chosen.side_by_side).pairs


def find_sequences(
    captured: Iterable[Captured],
    patterns: ShownPatterns,
    announcements: Sequence[tuple[int, int]] = (),
    settle: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[tuple[list[Capture], StereoRig]]:
    """The complete sequences among captures, each with its captures in the order of the patterns.

    As the node does it: by announcements where there are any, else by changes of the images. As many captures as there
    are patterns are one sequence.

    Args:
        captured: captures and their rig.
        patterns: what the projector shows.
        announcements: time, nanoseconds, and number of each announced pattern.
        settle: captures that are skipped after a change; of one pattern every capture is a scan.
        progress: called with the captures read, twice.

    Raises:
        ImageError: none is complete, with what is missing.
        ConfigError: an announced number that the sequence does not have.
    """

    settle = settling(patterns, settle)
    collector: AnnouncedPatterns[Capture] | ChangingPatterns[Capture]
    announced = collector = AnnouncedPatterns(len(patterns), settle)
    if not announcements:
        collector = by_changes(patterns, settle)
    waiting = sorted(announcements)
    first: list[Capture] = []
    found = count = 0
    rig: StereoRig | None = None
    for count, (capture, rig) in enumerate(captured, start=1):
        while waiting and waiting[0][0] <= capture[0].stamp_ns:
            announced.show(waiting.pop(0)[1])
        complete = collector.add(capture, rig)
        if complete is not None:
            found += 1
            yield complete, rig
        if count <= len(patterns):
            first.append(capture)
        progress(count, count)
    if found:
        return
    if count == len(patterns) and rig is not None and not announcements:
        if not (problem := _fault(patterns, first)):
            yield first, rig
            return
    elif isinstance(collector, AnnouncedPatterns):
        problem = f"the images of patterns are missing: {_named(patterns, collector.missing)}"
    elif count < len(patterns):
        problem = _fault(patterns, first)
    else:
        problem = (
            f"{collector.seen} of {count} captures differ, and no {len(patterns)} of them in a row are the sequence"
        )
        problem += f": {collector.fault}" if collector.fault else ""
    raise ImageError(
        problem,
        subject="scan",
        value=count,
        limit=len(patterns),
        remedy="capture every pattern once, or correct the manifest",
        settings=("patterns",),
    )


def _fault(patterns: ShownPatterns, captures: Sequence[Capture]) -> str:
    return patterns.fault([each[0] for each in captures])


def _named(patterns: ShownPatterns, numbers: Sequence[int]) -> str:
    """Patterns by number and content, the first few of them."""
    more = f" and {len(numbers) - _NAMED} more" if len(numbers) > _NAMED else ""
    return ", ".join(f"{number} ({patterns.name(number)})" for number in numbers[:_NAMED]) + more


def _only_images(reader: BagReader) -> str:
    """The topic of images, of which there is one.

    Raises:
        TopicError: none, or several.
    """
    topics = [topic for topic, kind in reader.msgtypes.items() if kind in _IMAGES]
    if len(topics) == 1:
        return topics[0]
    found = ", ".join(topics) if topics else "none"
    raise TopicError(
        f"has {len(topics)} image topics ({found}), one camera beside a projector has one",
        subject=str(reader.path),
        value=topics,
        limit=1,
        remedy="name the topic",
        settings=("left",),
    )

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Light stripe scans without a ROS graph: images and the motion at their time, to a bag of clouds."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np

from stereo_depth_ros.active.light_stripe.motion import MotionTrack, StripeMotion
from stereo_depth_ros.active.light_stripe.motion_table import MotionTable
from stereo_depth_ros.active.light_stripe.scanner import MergedCloud, ScannedProfile
from stereo_depth_ros.active.light_stripe.stripe_messages import (
    MERGED_TOPIC,
    PROFILE_TOPIC,
    merged_message,
    profile_message,
)
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagMessage, BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import BagError, MessageError, StereoDepthError, TopicError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, Frame, StereoPair
from stereo_depth_ros.datasets.image_files import framed, image_frame, read_pair
from stereo_depth_ros.datasets.image_pairs import find_image_pairs
from stereo_depth_ros.datasets.numbered_images import read_plain_frame
from stereo_depth_ros.messages.image import decode
from stereo_depth_ros.messages.motion import joint_value, pose_value

__all__ = [
    "Capture",
    "StripeScan",
    "bag_images",
    "bag_motion",
    "folder_images",
    "folder_pairs",
    "scan_stripes",
    "with_motion",
]

_INTERVAL_NS = 100_000_000  # between the stamps of the images of a folder
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_MOTIONS = ("sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped")

# Name, and what makes the image or the pair
Capture: TypeAlias = tuple[str, Callable[[], Any]]


class _Scanner(Protocol):
    motion: StripeMotion

    def scan(self, frame: Any, value: F64 | None) -> ScannedProfile: ...


@dataclass
class StripeScan:
    """Result of a scan.

    Attributes:
        cloud: the merged points.
        first: the first image that gave points, and its profile; None where none did.
        profiles: number of images that gave points.
        skipped: a sentence for each image that was not used.
        without_motion: number of images at whose time no motion is known.
    """

    cloud: MergedCloud
    first: tuple[Frame, ScannedProfile] | None = None
    profiles: int = 0
    skipped: list[str] = field(default_factory=list)
    without_motion: int = 0

    @property
    def reasons(self) -> Counter[str]:
        """Lines with a point, as POINTS, and without by reason."""
        return self.cloud.reasons


def folder_images(paths: Iterable[Path]) -> list[Capture]:
    """Captures of image files, a tenth of a second apart."""

    def reader(number: int, path: Path) -> Callable[[], Frame]:
        return lambda: read_plain_frame(path, number * _INTERVAL_NS)

    return [(path.name, reader(number, path)) for number, path in enumerate(paths)]


def folder_pairs(
    folder: Path, rig: StereoRig, left: str | None = None, right: str | None = None, *, side_by_side: bool = False
) -> list[Capture]:
    """Captures of two cameras, named by their left file; see :func:`find_image_pairs`."""
    cameras = framed(rig)

    def reader(number: int, paths: tuple[Path, Path]) -> Callable[[], StereoPair]:
        def read() -> StereoPair:
            images = read_pair(*paths)
            stamp_ns = number * _INTERVAL_NS
            return StereoPair(*(image_frame(image, cameras.left, stamp_ns) for image in images))

        return read

    found = find_image_pairs(folder, left, right, side_by_side=side_by_side)
    return [(pair[0].name, reader(number, pair)) for number, pair in enumerate(found.pairs)]


def bag_images(path: Path, topic: str | None = None, setting: str = "left") -> Iterator[Capture]:
    """Captures of one image topic of a bag; None takes the only one. ``setting`` names the topic in errors.

    Raises:
        TopicError: no image topic of that name, or several without a name.
    """
    with BagReader(path) as reader:
        chosen = _topic(reader, topic, _IMAGES, "image", setting)
        for message in reader.messages([chosen]):
            read = functools.partial(_decoded, reader, message)
            yield f"{message.log_time_ns / 1e9:.3f} s", read


def _decoded(reader: BagReader, message: BagMessage) -> Frame:
    return decode(reader.deserialize(message), message.topic)


def bag_motion(path: Path, topic: str | None, joint: str) -> tuple[str, MotionTrack, str]:
    """Kind ("joint" or "pose"), values and frame of a motion topic of a bag; None takes the only one.

    Raises:
        TopicError: no motion topic of that name, or several without a name.
        MessageError: a message without the joint, or with values that are not finite.
    """
    track, frame_id = MotionTrack(), ""
    with BagReader(path) as reader:
        chosen = _topic(reader, topic, _MOTIONS, "motion", "motion_topic")
        is_joint = reader.topics[chosen].msgtype == _MOTIONS[0]
        for message in reader.messages([chosen]):
            found = reader.deserialize(message)
            if is_joint and joint and joint not in found.name:
                continue  # other publishers have other joints
            frame_id = str(found.header.frame_id)
            track.add(*(joint_value(found, joint, chosen) if is_joint else pose_value(found, chosen)))
    if not len(track):
        raise TopicError(
            f"{chosen} holds no joint {quoted(joint)}",
            subject=str(path),
            value=joint,
            remedy="name one of its joints",
            settings=("joint", "motion_joint"),
        )
    return "joint" if is_joint else "pose", track, frame_id


def _topic(reader: BagReader, topic: str | None, kinds: tuple[str, ...], what: str, setting: str) -> str:
    found = [name for name, info in reader.topics.items() if info.msgtype in kinds]
    if topic is not None and topic in found:
        return topic
    if topic is None and len(found) == 1:
        return found[0]
    named = f"{topic} is not a topic of {what}s" if topic is not None else f"{len(found)} topics of {what}s"
    raise TopicError(
        f"{named}; the bag has {', '.join(found) or 'none'}",
        subject=str(reader.path),
        value=topic,
        limit=found,
        remedy="name one of them" if found else f"record {' or '.join(kinds)}",
        settings=(setting,),
    )


def with_motion(name: str, stamp_ns: int, table: MotionTable | None, step: float | None, number: int) -> F64 | None:
    """The value of the motion of an image: of a table, or by equal steps; an empty array where nothing moves.

    Returns None where the table has no value for it.
    """
    if step is not None:
        return np.array([step * number])
    if table is None:
        return np.zeros(0)
    return table.by_image.get(name) if table.by_image else table.track.at(stamp_ns)


def scan_stripes(
    captures: Iterable[Capture],
    scanner: _Scanner,
    value_of: Callable[[str, int, int], F64 | None],
    output: Path,
    *,
    pose_frame: str = "",
    metadata: Mapping[str, str] | None = None,
    overwrite: bool = False,
    progress: Callable[[int], object] = lambda done: None,
) -> StripeScan:
    """Scan all captures, and write the cloud of each and the merged one to a bag.

    Args:
        captures: the images, in order.
        scanner: makes the profiles.
        value_of: value of the motion by name, stamp and number of a capture; None where it is not known.
        output: the bag, ``.mcap``: stripe/points2, and at its end stripe/merged, latched.
        pose_frame: frame of the poses of the motion.
        metadata: names and values that are written into the bag.
        overwrite: replace a file that is there.
        progress: called with the number of captures done.

    Raises:
        BagError: no capture gives points; the sentences of what was skipped are in it.
        OutputError: the bag cannot be written.
    """
    types, result, last = RosbagsTypes(), StripeScan(MergedCloud(10**9)), (0, "")
    with BagWriter(output, overwrite=overwrite) as bag:
        bag.write_metadata("stripe_scan", metadata or {})
        for number, (name, read) in enumerate(captures):
            progress(number)
            try:
                image = read()
                frame = image if isinstance(image, Frame) else image.left
                value = value_of(name, frame.stamp_ns, number)
                if value is None:
                    result.without_motion += 1
                    continue
                profile = scanner.scan(image, value)
            except StereoDepthError as error:
                if not isinstance(error, (BagError, MessageError)):
                    raise error.about(name) from error
                result.skipped.append(f"{name}: skipped, {error}")
                continue
            last = profile.stamp_ns, scanner.motion.merged_frame(profile.frame_id, pose_frame)
            result.cloud.add(profile)
            bag.write(f"/{PROFILE_TOPIC}", profile_message(types, profile), profile.stamp_ns)
            if len(profile.found.lines):
                result.profiles += 1
                result.first = result.first or (frame, profile)
        if not result.profiles:
            raise _nothing_found(result)
        message = merged_message(types, result.cloud, *last)
        bag.write_raw(f"/{MERGED_TOPIC}", message.__msgtype__, types.serialize(message), last[0], latched=True)
    return result


def _nothing_found(result: StripeScan) -> BagError:
    if result.without_motion and not len(result.cloud):
        return BagError(
            f"the motion is not known for any of {result.without_motion} images",
            value=result.without_motion,
            remedy="name the images, or their times, in the table of the motion",
            settings=("motion", "motion_topic"),
        )
    reasons = ", ".join(f"{name.lower().replace('_', ' ')} {count}" for name, count in result.reasons.items() if count)
    detail = "; ".join(filter(None, (reasons, *result.skipped[:3])))
    return BagError(
        f"none of {len(result.cloud) + len(result.skipped)} images gives a point ({detail or 'there are none'})",
        value=0,
        remedy="check direction, color and width of the stripe, and the depth range",
        settings=("stripe_direction", "stripe_channel", "stripe_width"),
    )

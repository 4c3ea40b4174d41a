# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera infos of calibration files, in place of those of a bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stereo_topics import CameraImages
from stereo_depth_ros.bags.topics import StereoTopics
from stereo_depth_ros.camera_files.reading import read_rig_files
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_size

__all__ = ["FileInfos", "file_infos"]


@dataclass(frozen=True)
class FileInfos:
    """The rig of calibration files for the images of a bag.

    Attributes:
        topics: those of the images; in place of the topics of the camera infos the names of the files.
        rig: for the images as they are recorded, with their frames.
    """

    topics: StereoTopics
    rig: StereoRig

    def messages(self, types: RosbagsTypes) -> tuple[bytes, bytes]:
        """The camera infos of the left and of the right camera as CDR bytes; their stamps are not set."""
        left, right = (
            types.serialize(camera_info_message(types, camera, 0)) for camera in (self.rig.left, self.rig.right)
        )
        return left, right


def file_infos(reader: BagReader, topics: StereoTopics, files: Sequence[Path]) -> FileInfos:
    """Read calibration files for the images of a bag.

    Args:
        reader: the bag.
        topics: of its images. Where their names state that they are rectified, only P of the files counts.
        files: as of :func:`read_rig_files`.

    Raises:
        BagError: a camera has no images.
        MessageError: the first image cannot be read.
        CalibrationError: the files are not those of a rig, or of one for images of another size.
    """
    left, right = _first_images(reader, topics)
    size = image_size(left, topics.left_image)
    rig = read_rig_files(files, size)
    for message, topic in ((left, topics.left_image), (right, topics.right_image)):
        rig.check_image(*image_size(message, topic), topic)
    left_camera, right_camera = (
        replace(camera.rectified() if topics.rectified else camera, frame_id=message.header.frame_id)
        for camera, message in ((rig.left, left), (rig.right, right))
    )
    named = replace(topics, left_info=rig.topics[0], right_info=rig.topics[1])
    return FileInfos(named, StereoRig(left_camera, right_camera, rig.topics))


def _first_images(reader: BagReader, topics: StereoTopics) -> tuple[Any, Any]:
    """The first image of each camera, not decoded."""
    cameras = CameraImages(reader, topics)
    found: dict[int, Any] = {}
    for topic in cameras.names:
        message = next(reader.messages([topic]), None)
        if message is None:
            raise BagError(f"{topic} has no messages", subject=str(reader.path), value=topic, remedy="record it again")
        found.update(cameras.images(message))
    return found[0], found[1]

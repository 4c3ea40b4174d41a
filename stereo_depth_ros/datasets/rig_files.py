# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads a rig from calibration files or from a bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files, is_bag
from stereo_depth_ros.bags.stereo_topics import bag_topics
from stereo_depth_ros.camera_files.reading import is_rig_folder, read_rig_files, rig_file_paths
from stereo_depth_ros.camera_files.stored import Size
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.rig import StereoRig

__all__ = ["is_bag_path", "read_rig", "rig_files"]


def read_rig(
    paths: Sequence[Path], left: str | None = None, right: str | None = None, size: Size | None = None
) -> StereoRig:
    """The rig of one or two paths.

    Args:
        paths: calibration files, or a folder that holds them, as of :func:`read_rig_files`; or a bag, of which the
            first camera infos are read.
        left, right: image topics of a bag; None finds them.
        size: of the images, px, for files that do not state it.

    Raises:
        BagError, TopicError: no readable bag, or no stereo pair with camera infos in it.
        CalibrationError: files that are missing or not those of a rig.
    """
    return _of_bag(paths[0], left, right) if is_bag_path(paths) else read_rig_files(paths, size)


def rig_files(paths: Sequence[Path]) -> list[Path]:
    """The files that :func:`read_rig` reads.

    Raises:
        CalibrationError: files that are not there.
    """
    return bag_files(paths[0]) if is_bag_path(paths) else rig_file_paths(paths)


def is_bag_path(paths: Sequence[Path]) -> bool:
    """Whether :func:`read_rig` takes the paths for a bag."""
    if len(paths) != 1 or not paths[0].exists():
        return False
    return is_bag(paths[0]) or (paths[0].is_dir() and not is_rig_folder(paths[0]))


def _of_bag(path: Path, left: str | None, right: str | None) -> StereoRig:
    with BagReader(path) as reader:
        topics = bag_topics(reader, left, right)
        left_camera = _camera(reader, topics.left_image, topics.left_info, topics.rectified)
        right_camera = _camera(reader, topics.right_image, topics.right_info, topics.rectified)
    return StereoRig(left_camera, right_camera, (topics.left_info or "", topics.right_info or ""))


def _camera(reader: BagReader, image: str, info: str | None, rectified: bool) -> CameraModel:
    """The camera of the first camera info; without distortion and rotation where the images are rectified."""
    message = next(reader.messages([info]), None) if info is not None else None
    if message is None:
        raise BagError(
            f"no CameraInfo belongs to {image}",
            subject=str(reader.path),
            value=image,
            remedy="record the camera infos too",
        )
    camera = camera_from_info(reader.deserialize(message), message.topic)
    return camera.rectified() if rectified else camera

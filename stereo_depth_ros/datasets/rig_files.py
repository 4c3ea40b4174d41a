# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads a rig from two calibration files, from one of them or the folder of both, or from a bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.bags.stereo_topics import bag_topics
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.rig import StereoRig

__all__ = ["read_rig", "rig_files"]

_YAML = (".yaml", ".yml")
_REMEDY = "give LEFT.yaml and RIGHT.yaml, a folder with both, or a bag"


def read_rig(paths: Sequence[Path], left: str | None = None, right: str | None = None) -> StereoRig:
    """The rig of one or two paths.

    Args:
        paths: LEFT.yaml and RIGHT.yaml in the format of camera_calibration; or a folder that holds left.yaml and
            right.yaml; or one of the two files, if the name of the other one has "right" in place of "left"; or a bag,
            of which the first camera infos are read.
        left, right: image topics of a bag; None finds them.

    Raises:
        BagError, TopicError: no readable bag, or no stereo pair with camera infos in it.
        CalibrationError: files that are missing or not those of a rig.
    """
    cameras = _camera_files(paths)
    return StereoRig.from_yaml(*cameras) if cameras else _of_bag(paths[0], left, right)


def is_bag_path(paths: Sequence[Path]) -> bool:
    """Whether :func:`read_rig` takes the paths for a bag.

    Raises:
        CalibrationError: files that are not there.
    """
    return _camera_files(paths) is None


def rig_files(paths: Sequence[Path]) -> list[Path]:
    """The files that :func:`read_rig` reads.

    Raises:
        CalibrationError: files that are not there.
    """
    return list(_camera_files(paths) or bag_files(paths[0]))


def _camera_files(paths: Sequence[Path]) -> tuple[Path, Path] | None:
    """Left and right file; None where the path is that of a bag."""
    if len(paths) == 2:
        return paths[0], paths[1]
    if len(paths) != 1:
        raise CalibrationError(f"{len(paths)} paths, not 1 or 2", value=len(paths), limit=(1, 2), remedy=_REMEDY)
    path = paths[0]
    if not path.exists():
        raise CalibrationError("does not exist", subject=str(path), remedy=_REMEDY)
    if path.is_dir() and any((path / f"left{suffix}").exists() for suffix in _YAML):
        return _of_folder(path)
    if path.suffix in _YAML:
        return _with_partner(path)
    return None


def _of_folder(folder: Path) -> tuple[Path, Path]:
    left = next(folder / f"left{suffix}" for suffix in _YAML if (folder / f"left{suffix}").exists())
    return _with_partner(left)


def _with_partner(path: Path) -> tuple[Path, Path]:
    """Left and right file, from one of them."""
    side, other = ("left", "right") if "left" in path.name else ("right", "left")
    before, _, after = path.name.rpartition(side)
    partner = path.with_name(f"{before}{other}{after}") if side in path.name else path
    if partner == path or not partner.exists():
        reason = (
            f"there is no {partner.name} in its folder" if partner != path else "its name has neither left nor right"
        )
        raise CalibrationError(
            f"is one camera, and {reason}", subject=str(path), remedy="give LEFT.yaml and RIGHT.yaml"
        )
    return (path, partner) if side == "left" else (partner, path)


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

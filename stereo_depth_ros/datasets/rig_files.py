# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rig that paths name: two camera files, a folder with both, one of them whose partner is beside it, or a bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.rig import StereoRig

__all__ = ["read_rig"]

_YAML = (".yaml", ".yml")


def read_rig(paths: Sequence[Path], left: str | None = None, right: str | None = None) -> StereoRig:
    """The rig of one or two paths.

    Args:
        paths: LEFT.yaml and RIGHT.yaml in the format of camera_calibration; or a folder that holds left.yaml and
            right.yaml; or one of the two files, the other one having "right" for "left" in its name; or a bag, whose
            first camera infos are read.
        left, right: image topics of a bag, where they are known.

    Raises:
        BagError, TopicError: no readable bag, or no stereo pair with camera infos in it.
        CalibrationError: files that are not there or not those of a rig.
    """
    if len(paths) == 2:
        return StereoRig.from_yaml(*paths)
    if len(paths) != 1:
        raise CalibrationError(f"{len(paths)} paths: give LEFT.yaml and RIGHT.yaml, a folder with both, or a bag")
    path = paths[0]
    if not path.exists():
        raise CalibrationError(f"{path} does not exist: give LEFT.yaml and RIGHT.yaml, a folder with both, or a bag")
    if path.is_dir() and any((path / f"left{suffix}").exists() for suffix in _YAML):
        return StereoRig.from_yaml(*_of_folder(path))
    if path.suffix in _YAML:
        return StereoRig.from_yaml(*_with_partner(path))
    return _of_bag(path, left, right)


def _of_folder(folder: Path) -> tuple[Path, Path]:
    left = next(folder / f"left{suffix}" for suffix in _YAML if (folder / f"left{suffix}").exists())
    return _with_partner(left)


def _with_partner(path: Path) -> tuple[Path, Path]:
    """Left and right file, from one of them."""
    side, other = ("left", "right") if "left" in path.name else ("right", "left")
    before, _, after = path.name.rpartition(side)
    partner = path.with_name(f"{before}{other}{after}") if side in path.name else path
    if partner == path or not partner.exists():
        beside = f"no {partner.name} is beside it" if partner != path else "its name tells neither camera"
        raise CalibrationError(f"{path} is one camera and {beside}: give LEFT.yaml and RIGHT.yaml")
    return (path, partner) if side == "left" else (partner, path)


def _of_bag(path: Path, left: str | None, right: str | None) -> StereoRig:
    with BagReader(path) as reader:
        topics = reader.stereo_topics(left, right)
        left_camera = _camera(reader, topics.left_image, topics.left_info, topics.rectified)
        right_camera = _camera(reader, topics.right_image, topics.right_info, topics.rectified)
    return StereoRig(left_camera, right_camera, (topics.left_info or "", topics.right_info or ""))


def _camera(reader: BagReader, image: str, info: str | None, rectified: bool) -> CameraModel:
    """Of the first camera info; of images that are rectified, without what has been done to them already."""
    message = next(reader.messages([info]), None) if info is not None else None
    if message is None:
        raise BagError(f"{reader.path}: no CameraInfo belongs to {image}: record the camera infos too")
    camera = camera_from_info(reader.deserialize(message), message.topic)
    return camera.rectified() if rectified else camera

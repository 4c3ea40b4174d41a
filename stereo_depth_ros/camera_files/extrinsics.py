# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files with the pose of a range sensor: YAML with translation and quaternion, and the calibrations of KITTI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.camera_files.kitti import matrix_of, parse_calibration
from stereo_depth_ros.camera_files.values import rigid
from stereo_depth_ros.core.camera import check_rotation
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.plain_values import entry, numbers
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.safe_yaml import YamlError, load_yaml
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.core.types import F64

__all__ = ["Extrinsics", "kitti_extrinsics", "read_extrinsics"]

_REMEDY = "give a YAML file with parent, child, translation and quaternion, or the calibration of KITTI"
_CAMERAS = "calib_cam_to_cam.txt"  # beside calib_velo_to_cam.txt
_UNIT = 1e-3  # largest deviation of the length of a quaternion from 1
_PARENTS, _CHILDREN = ("parent", "parent_frame", "frame_id"), ("child", "child_frame", "child_frame_id")
_QUATERNIONS = ("quaternion", "rotation", "orientation")


@dataclass(frozen=True)
class Extrinsics:
    """The pose of a sensor.

    Attributes:
        parent_from_child: takes points of the sensor to the parent.
        parent: name of that frame; empty for the left camera.
        child: frame of the sensor; empty for that of its messages.
        rectified: the parent is the left rectified camera, whose frame has no name.
    """

    parent_from_child: Pose
    parent: str = ""
    child: str = ""
    rectified: bool = False


def read_extrinsics(path: Path) -> Extrinsics:
    """The pose in a file.

    These are YAML with ``parent``, ``child``, ``translation`` (x, y, z in meters) and ``quaternion`` (x, y, z, w), also
    as ``ros2 topic echo /tf_static`` prints a transform, or with a 4x4 ``matrix``; calib.txt of KITTI odometry,
    calib_velo_to_cam.txt of a drive, beside its calib_cam_to_cam.txt, and the files of the object benchmark.

    Raises:
        CalibrationError: not such a file, or numbers that are not those of a pose.
    """
    text = read_text(path, CalibrationError, _REMEDY)
    try:
        if path.suffix in (".yaml", ".yml", ".json"):
            return _of_yaml(text)
        cameras = path.with_name(_CAMERAS)
        beside = read_text(cameras, CalibrationError, _REMEDY) if cameras.is_file() else ""
        return kitti_extrinsics(parse_calibration(text), parse_calibration(beside))
    except BagError as error:
        raise CalibrationError(error.problem, subject=str(path), remedy=error.remedy) from error
    except CalibrationError as error:
        raise error.about(path) from error


def kitti_extrinsics(values: Mapping[str, F64], cameras: Mapping[str, F64]) -> Extrinsics:
    """The pose of the laser scanner of KITTI in camera 0.

    Args:
        values: of :func:`parse_calibration`: Tr of odometry, which goes to the rectified camera; R and T of
            calib_velo_to_cam.txt or Tr_velo_to_cam of the object benchmark, which go to the camera before
            rectification.
        cameras: of calib_cam_to_cam.txt, for its R_rect_00; empty without it.

    Raises:
        CalibrationError: none of these, or not a rotation.
        BagError: an incomplete matrix.
    """
    if "Tr" in values:
        return Extrinsics(_pose(matrix_of(values, "Tr", (3, 4))), rectified=True)
    if "Tr_velo_to_cam" in values:
        pose, rectification = _pose(matrix_of(values, "Tr_velo_to_cam", (3, 4))), ("R0_rect", values)
    elif "R" in values and "T" in values:
        both = np.column_stack([matrix_of(values, "R", (3, 3)), matrix_of(values, "T", (3, 1))])
        pose, rectification = _pose(both), ("R_rect_00", cameras)
    else:
        raise CalibrationError(
            f"has no pose of a sensor, it has {quoted(', '.join(values))}",
            value=list(values),
            limit=("Tr", "Tr_velo_to_cam", "R and T"),
            remedy=_REMEDY,
        )
    name, source = rectification
    if name not in source:
        return Extrinsics(pose)
    R = matrix_of(source, name, (3, 3))
    check_rotation(R, name)
    return Extrinsics(Pose(R, np.zeros(3)) @ pose, rectified=True)


def _pose(matrix: F64) -> Pose:
    check_rotation(matrix[:, :3], "the rotation")
    if not np.isfinite(matrix).all():
        raise CalibrationError("the translation is not finite", value=matrix[:, 3], remedy="copy it again")
    return Pose.from_matrix(matrix)


def _of_yaml(text: str) -> Extrinsics:
    try:
        document = load_yaml(text.split("\n---")[0])
    except YamlError as error:
        raise CalibrationError(f"is not YAML: {error}", remedy=_REMEDY) from error
    while isinstance(document, Mapping) and isinstance(document.get("transforms"), list) and document["transforms"]:
        document = document["transforms"][0]
    if not isinstance(document, Mapping):
        raise CalibrationError("is not a mapping of names to values", remedy=_REMEDY)
    header = document["header"] if isinstance(document.get("header"), Mapping) else {}
    inner = document["transform"] if isinstance(document.get("transform"), Mapping) else {}
    flat = {**header, **document, **inner}
    parent, child = (_name(flat, names) for names in (_PARENTS, _CHILDREN))
    if "matrix" in flat:
        return Extrinsics(Pose.from_matrix(rigid(flat["matrix"], "matrix")), parent, child)
    name = next((name for name in _QUATERNIONS if name in flat), _QUATERNIONS[0])
    quaternion = _named_numbers(entry(flat, name), name, "xyzw")
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1) > _UNIT:
        raise CalibrationError(
            f"{name} has the length {length:.6g}, limit {_UNIT:g} from 1",
            value=length,
            limit=1,
            remedy="write a unit quaternion x, y, z, w",
        )
    return Extrinsics(
        Pose.from_quaternion(quaternion, _named_numbers(entry(flat, "translation"), "translation", "xyz")),
        parent,
        child,
    )


def _named_numbers(value: Any, name: str, keys: str) -> F64:
    """A list of numbers, or a mapping with these keys."""
    listed = [entry(value, key) for key in keys] if isinstance(value, Mapping) else value
    return numbers(listed, name, len(keys))


def _name(values: Mapping[str, Any], names: tuple[str, ...]) -> str:
    found = next((values[name] for name in names if name in values), "")
    if not isinstance(found, str):
        raise CalibrationError(
            f"{names[0]} is {quoted(found)}, not the name of a frame", value=found, limit="a name", remedy=_REMEDY
        )
    return found

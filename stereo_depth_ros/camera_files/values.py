# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Values that several formats of calibration files have: intrinsics, sizes, poses, matrices of OpenCV."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from stereo_depth_ros.camera_files.stored import Pose, Size
from stereo_depth_ros.core.camera import check_rotation
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry, numbers, whole
from stereo_depth_ros.core.types import F64

__all__ = ["camera_matrix", "image_size", "inverse", "matrix", "pose_of", "rigid", "rotation"]


def camera_matrix(value: Any, name: str) -> F64:
    """float64 (3, 3) of the list fx, fy, cx, cy."""
    fx, fy, cx, cy = numbers(value, name, 4)
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def image_size(value: Any, name: str) -> Size:
    """Width and height of a list of both, px."""
    numbers(value, name, 2)
    return whole(value[0], name), whole(value[1], name)


def matrix(value: Any, name: str, *counts: int) -> F64:
    """float64 (n,): the numbers of a list, or of a matrix of OpenCV, row by row; ``counts`` as of :func:`numbers`."""
    return numbers(entry(value, "data") if isinstance(value, Mapping) else value, name, *counts)


def rotation(value: Any, name: str) -> F64:
    """float64 (3, 3), a rotation; three numbers are a rotation vector, as of OpenCV's Rodrigues."""
    found = matrix(value, name, 3, 9)
    R = cv2.Rodrigues(found)[0].astype(np.float64) if found.size == 3 else found.reshape(3, 3)
    check_rotation(R, name)
    return R


def rigid(value: Any, name: str) -> F64:
    """float64 (4, 4), rotation and translation in meters; the last row may be missing.

    Raises:
        CalibrationError: not 12 or 16 numbers, or not a rotation.
    """
    found = matrix(value, name, 12, 16)
    T = np.identity(4)
    T[:3] = found[:12].reshape(3, 4)
    if found.size == 16 and not np.array_equal(found[12:], [0, 0, 0, 1]):
        raise CalibrationError(
            f"the last row of {name} is {found[12:].tolist()}",
            value=found[12:],
            limit=[0, 0, 0, 1],
            remedy="write it row by row",
        )
    check_rotation(T[:3, :3], name)
    return T


def pose_of(T: F64) -> Pose:
    """R and T of a float64 (4, 4)."""
    return T[:3, :3], T[:3, 3]


def inverse(pose: Pose) -> Pose:
    """The pose in the other direction."""
    R, T = pose
    return R.T, -R.T @ T

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The calibration of KITTI: calib.txt of odometry and of the benchmarks, calib_cam_to_cam.txt of the raw drives.

Geiger et al., "Vision meets robotics: the KITTI dataset", IJRR 2013.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from stereo_depth_ros.camera_files.assembling import no_size
from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.stored import Size, StoredFile
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

__all__ = [
    "KITTI",
    "is_kitti",
    "matrix_of",
    "parse_calibration",
    "read_kitti",
    "reference_from_camera",
    "rig_from_calibration",
]

KITTI = "KITTI calibration"
_GRAY = (0, 1)  # numbers of the cameras


def is_kitti(document: Document) -> bool:
    """Whether the document is the text of a KITTI calibration: rows of projection matrices."""
    return re.search(r"^[ \t]*(P_?(rect_)?\d+:|[-+.\d])", document.text, re.MULTILINE) is not None


def read_kitti(document: Document) -> StoredFile:
    """The rig of the gray cameras, 0 and 1.

    Raises:
        CalibrationError: a row with text that is not a number.
    """
    try:
        values = parse_calibration(document.text)
    except BagError as error:
        raise CalibrationError(error.problem, remedy=error.remedy) from error

    def build(size: Size | None) -> StereoRig:
        stored = values.get("S_rect_00", np.zeros(0))
        known = size or (_size(stored) if stored.size == 2 else None)
        if known is None:
            raise no_size(document.source)
        try:
            return rig_from_calibration(values, _GRAY, known)
        except BagError as error:
            raise CalibrationError(error.problem, subject=document.source, remedy=error.remedy) from error

    return StoredFile(KITTI, document.source, build=build)


def _size(stored: F64) -> Size | None:
    """The size of a row of numbers; None where it is not one."""
    if not np.isfinite(stored).all() or not ((stored >= 1) & (stored <= 65535)).all():
        return None
    return int(stored[0]), int(stored[1])


def parse_calibration(text: str) -> dict[str, F64]:
    """The values of a calibration file by name, float64 (N,); rows without names are P0, P1, ...

    Raises:
        BagError: a row with text that is not a number.
    """
    values: dict[str, F64] = {}
    for row in text.splitlines():
        name, colon, numbers = row.rpartition(":")
        if not row.strip() or name == "calib_time" or row.startswith("calib_time"):
            continue
        try:
            values[name.strip() if colon else f"P{len(values)}"] = np.array(numbers.split(), np.float64)
        except ValueError as error:
            raise BagError(
                f"is not a KITTI calibration, row {quoted(row)} has a word that is not a number",
                value=row,
                remedy="copy it again",
            ) from error
    return values


def rig_from_calibration(values: dict[str, F64], cameras: tuple[int, int], size: tuple[int, int]) -> StereoRig:
    """The rig of two cameras.

    Images of size S_rect, and all of odometry, are rectified; images of size S are raw and have K, D, R_rect. The
    vertical offset of some millimeters in P of the color cameras is ignored: their rows are aligned.

    Args:
        values: result of :func:`parse_calibration`.
        cameras: numbers of the left and the right camera.
        size: (width, height) of the images, pixels.

    Raises:
        BagError: the calibration lacks these cameras, or a matrix is incomplete.
        CalibrationError: the calibration is not that of a rectified pair.
    """
    left, right = cameras
    try:
        P_left, P_right = (_projection(values, camera) for camera in cameras)
    except KeyError as error:
        raise _lacks(values, error) from error
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # refused by the checks of a rig
        baseline_m = float((P_left[0, 3] - P_right[0, 3]) / P_left[0, 0])
    rig = StereoRig.from_rectified(
        P_left[0, 0], P_left[1, 1], P_left[0, 2], P_right[0, 2], P_left[1, 2], baseline_m, size
    )
    raw_size = values.get(f"S_{left:02d}")
    if raw_size is None or tuple(raw_size) != size:
        return rig
    try:
        return StereoRig(_raw_camera(values, left, rig.left), _raw_camera(values, right, rig.right))
    except KeyError as error:
        raise _lacks(values, error) from error


def reference_from_camera(values: dict[str, F64], camera: int) -> Pose:
    """The pose of a rectified camera in the frame of camera 0, which the poses of KITTI odometry are of.

    Its projection matrix is K (1 | t), with X_camera = X_0 + t.

    Args:
        values: result of :func:`parse_calibration`.
        camera: its number.

    Raises:
        BagError: the calibration lacks this camera, or its matrix is incomplete.
    """
    try:
        P = _projection(values, camera)
    except KeyError as error:
        raise _lacks(values, error) from error
    t_z = P[2, 3]
    t_x, t_y = (P[0, 3] - P[0, 2] * t_z) / P[0, 0], (P[1, 3] - P[1, 2] * t_z) / P[1, 1]
    return Pose(np.identity(3), -np.array([t_x, t_y, t_z]))


def _lacks(values: dict[str, F64], error: KeyError) -> BagError:
    names = quoted(", ".join(values))
    return BagError(
        f"the KITTI calibration has no {error.args[0]}, it has {names}",
        value=list(values),
        limit=error.args[0],
        remedy="copy the calibration of these cameras",
    )


def _projection(values: Mapping[str, F64], camera: int) -> F64:
    name = f"P{camera}" if f"P{camera}" in values else f"P_rect_{camera:02d}"
    return matrix_of(values, name, (3, 4))


def matrix_of(values: Mapping[str, F64], name: str, shape: tuple[int, int]) -> F64:
    """The values of one row as a matrix.

    Raises:
        KeyError: the row is missing.
        BagError: it has another number of values.
    """
    found = values[name]
    if found.size != shape[0] * shape[1]:
        raise BagError(
            f"{name} of the KITTI calibration has {found.size} numbers, not {shape[0] * shape[1]}",
            value=found.size,
            limit=shape[0] * shape[1],
            remedy="copy the calibration again",
        )
    return found.reshape(shape)


def _raw_camera(values: dict[str, F64], camera: int, rectified: CameraModel) -> CameraModel:
    K, R = (matrix_of(values, f"{name}_{camera:02d}", (3, 3)) for name in ("K", "R_rect"))
    return CameraModel(
        rectified.width,
        rectified.height,
        "plumb_bob",
        K,
        values[f"D_{camera:02d}"],
        R,
        rectified.P,
        rectified.frame_id,
    )

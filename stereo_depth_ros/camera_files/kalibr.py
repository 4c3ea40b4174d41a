# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera chains of Kalibr (camchain) and of OpenVINS, which has the same keys.

Intrinsics are fu, fv, pu, pv; ``T_cn_cnm1`` takes cam0 to cam1; ``T_cam_imu`` and ``T_imu_cam`` are poses to the IMU.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.fov import fov_as_equidistant
from stereo_depth_ros.camera_files.stored import Pose, StoredCamera, StoredFile
from stereo_depth_ros.camera_files.values import camera_matrix, image_size, pose_of, rigid
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry, numbers
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64

__all__ = ["KALIBR", "is_camchain", "read_camchain"]

KALIBR = "Kalibr camchain"
_MODELS = {
    "radtan": ("plumb_bob", 4),
    "plumb_bob": ("plumb_bob", 4),
    "equi": ("equidistant", 4),
    "equidistant": ("equidistant", 4),
    "none": ("plumb_bob", 0),
}


def is_camchain(document: Document) -> bool:
    """Whether the document is a chain of cameras."""
    cam0 = document.values.get("cam0")
    return isinstance(cam0, Mapping) and "intrinsics" in cam0


def read_camchain(document: Document) -> StoredFile:
    """cam0 and cam1; the pose decides which of them is the left one.

    Raises:
        CalibrationError: a camera is not a pinhole, or a value is missing or not a number.
    """
    names = [name for name in ("cam0", "cam1") if name in document.values]
    cameras = tuple(_camera(name, document.values[name]) for name in names)
    pose = _pose(document.values["cam1"]) if len(names) == 2 else None
    if len(names) == 2 and pose is None and any(camera.body is None for camera in cameras):
        raise CalibrationError(f"{KALIBR} without the pose of cam1, T_cn_cnm1", remedy="write the pose of cam1")
    return StoredFile(KALIBR, document.source, cameras, pose, numbered=True)


def _pose(values: Any) -> Pose | None:
    has_pose = isinstance(values, Mapping) and "T_cn_cnm1" in values
    return pose_of(rigid(values["T_cn_cnm1"], "T_cn_cnm1")) if has_pose else None


def _camera(name: str, values: Any) -> StoredCamera:
    if not isinstance(values, Mapping):
        raise CalibrationError(f"{KALIBR}, but {name} holds no keys", remedy="write it again")
    model = str(values.get("camera_model", "pinhole"))
    if model != "pinhole":
        raise CalibrationError(
            f"{KALIBR} of a camera of model {quoted(model)} ({name}), which has no pinhole",
            value=model,
            limit="pinhole",
            remedy="calibrate with pinhole-radtan or pinhole-equi",
        )
    K = camera_matrix(entry(values, "intrinsics"), f"{name}.intrinsics")
    size = image_size(entry(values, "resolution"), f"{name}.resolution")
    lens, coefficients = str(values.get("distortion_model", "none")), values.get("distortion_coeffs", [])
    if lens == "fov":
        K, D = fov_as_equidistant(K, float(numbers(coefficients, f"{name}.distortion_coeffs", 1)[0]), size)
        return StoredCamera(name, K, "equidistant", D, size, body=_body(values, name))
    if lens not in _MODELS:
        raise CalibrationError(
            f"{KALIBR} with distortion_model {quoted(lens)} ({name})",
            value=lens,
            limit=(*_MODELS, "fov"),
            remedy="calibrate with pinhole-radtan or pinhole-equi",
        )
    known, count = _MODELS[lens]
    D = numbers(coefficients, f"{name}.distortion_coeffs", count) if count else np.zeros(5)
    if known == "plumb_bob" and count:
        D = np.append(D, 0.0)
    return StoredCamera(name, K, known, D, size, body=_body(values, name))


def _body(values: Any, name: str) -> F64 | None:
    """The pose of the camera in the frame of the IMU."""
    if "T_imu_cam" in values:
        return rigid(values["T_imu_cam"], f"{name}.T_imu_cam")
    if "T_cam_imu" in values:
        return np.linalg.inv(rigid(values["T_cam_imu"], f"{name}.T_cam_imu")).astype(np.float64)
    return None

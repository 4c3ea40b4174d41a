# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of camodocal and VINS: a camera each, and their poses in a file of their own or in the settings of VINS.

Heng, Li and Pollefeys, "CamOdoCal: automatic intrinsic and extrinsic calibration of a rig with multiple generic
cameras and odometry", IROS 2013.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.stored import StoredCamera, StoredFile
from stereo_depth_ros.camera_files.values import rigid
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry, number, whole
from stereo_depth_ros.core.pose import quaternion_rotation
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64

__all__ = [
    "CAMODOCAL",
    "EXTRINSICS",
    "VINS",
    "is_camera",
    "is_extrinsics",
    "is_vins",
    "read_camera",
    "read_extrinsics",
    "read_vins",
]

CAMODOCAL, VINS = "camodocal camera", "VINS settings"
EXTRINSICS = "camodocal extrinsics"
# model: names of fx, fy, cx, cy, distortion model of ROS, where its coefficients stand and their names
_PINHOLE = ("fx", "fy", "cx", "cy")
_MODELS = {
    "PINHOLE": (_PINHOLE, "plumb_bob", "distortion_parameters", ("k1", "k2", "p1", "p2")),
    "PINHOLE_FULL": (
        *(_PINHOLE, "rational_polynomial", "distortion_parameters", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    ),
    "KANNALA_BRANDT": (*(("mu", "mv", "u0", "v0"), "equidistant", "projection_parameters", ("k2", "k3", "k4", "k5")),),
}


def is_camera(document: Document) -> bool:
    """Whether the document is a camera of camodocal."""
    return "model_type" in document.values


def read_camera(document: Document) -> StoredFile:
    """One camera.

    Raises:
        CalibrationError: a mirror (MEI) or another model without pinhole, or a value is missing or not a number.
    """
    values = document.values
    model = str(values["model_type"])
    if model not in _MODELS:
        kind = ", an omnidirectional camera" if model == "MEI" else ""
        raise CalibrationError(
            f"{CAMODOCAL} of model_type {quoted(model)}{kind}",
            value=model,
            limit=tuple(_MODELS),
            remedy="calibrate with PINHOLE, or a fisheye with KANNALA_BRANDT",
        )
    names, known, place, coefficients = _MODELS[model]
    fx, fy, cx, cy = (_at(values, "projection_parameters", name) for name in names)
    D = np.array([_at(values, place, name) for name in coefficients])
    if known == "plumb_bob":
        D = np.append(D, 0.0)
    size = whole(entry(values, "image_width"), "image_width"), whole(entry(values, "image_height"), "image_height")
    camera = StoredCamera("", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64), known, D, size)
    return StoredFile(CAMODOCAL, document.source, (camera,))


def is_extrinsics(document: Document) -> bool:
    """Whether the document is the ``extrinsics.yaml`` of a stereo calibration."""
    transform = document.values.get("transform")
    return isinstance(transform, dict) and "q_w" in transform


def read_extrinsics(document: Document) -> StoredFile:
    """The pose: from the left to the right camera, a unit quaternion and meters."""
    q = np.array([_at(document.values, "transform", f"q_{axis}") for axis in "xyzw"])
    T = np.array([_at(document.values, "transform", f"t_{axis}") for axis in "xyz"])
    if abs(np.linalg.norm(q) - 1) > 1e-3:
        raise CalibrationError(
            f"the quaternion q of transform has the norm {np.linalg.norm(q):g}",
            limit=1,
            remedy="write a unit quaternion",
        )
    return StoredFile(EXTRINSICS, document.source, pose=(quaternion_rotation(q), T))


def is_vins(document: Document) -> bool:
    """Whether the document is the settings file of VINS."""
    return "cam0_calib" in document.values or "body_T_cam0" in document.values


def read_vins(document: Document, read_beside: Callable[[str], StoredFile]) -> StoredFile:
    """Both cameras, of the files that the settings name, with their poses.

    Args:
        document: the settings.
        read_beside: reads a file of that name in the folder of the settings.

    Raises:
        CalibrationError: settings of one camera, or a value is missing.
    """
    values = document.values
    if not {"body_T_cam1", "cam1_calib"} <= values.keys():
        raise CalibrationError(f"{VINS} of one camera", value=1, limit=2, remedy="give the settings of two cameras")
    cameras = []
    for name in ("cam0", "cam1"):
        body = rigid(entry(values, f"body_T_{name}"), f"body_T_{name}")
        found = read_beside(str(entry(values, f"{name}_calib"))).cameras
        if len(found) != 1:
            raise CalibrationError(f"{name}_calib is not the file of one camera", remedy="name the file of the camera")
        cameras.append(_with_body(found[0], name, body))
    return StoredFile(VINS, document.source, tuple(cameras), numbered=True)


def _with_body(camera: StoredCamera, name: str, body: F64) -> StoredCamera:
    return StoredCamera(name, camera.K, camera.distortion_model, camera.D, camera.size, body=body)


def _at(values: Any, *keys: str) -> float:
    return number(entry(values, *keys), ".".join(keys))

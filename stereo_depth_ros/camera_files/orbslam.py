# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of ORB-SLAM3 for stereo cameras: Camera1, Camera2 and Stereo.T_c1_c2, or a rectified pair."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stereo_depth_ros.camera_files.assembling import no_size
from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.stored import Size, StoredCamera, StoredFile
from stereo_depth_ros.camera_files.values import inverse, pose_of, rigid
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry, number, whole
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.rig import StereoRig

__all__ = ["ORB_SLAM", "is_settings", "read_settings"]

ORB_SLAM = "ORB-SLAM3 settings"
_COEFFICIENTS = {"PinHole": ("k1", "k2", "p1", "p2"), "KannalaBrandt8": ("k1", "k2", "k3", "k4"), "Rectified": ()}


def is_settings(document: Document) -> bool:
    """Whether the document is a settings file."""
    return {"Camera.type", "Camera1.fx"} <= document.values.keys()


def read_settings(document: Document) -> StoredFile:
    """Both cameras.

    Raises:
        CalibrationError: settings of one camera, another model, or a value is missing or not a number.
    """
    values, model = document.values, str(document.values["Camera.type"])
    if model not in _COEFFICIENTS:
        raise CalibrationError(
            f"{ORB_SLAM} with Camera.type {quoted(model)}",
            value=model,
            limit=tuple(_COEFFICIENTS),
            remedy="write one of them",
        )
    size = None
    if "Camera.width" in values:
        size = _whole(values, "Camera.width"), _whole(values, "Camera.height")
    if model == "Rectified":
        fx, fy, cx, cy, baseline_m = (
            _number(values, key) for key in ("Camera1.fx", "Camera1.fy", "Camera1.cx", "Camera1.cy", "Stereo.b")
        )

        def build(given: Size | None) -> StereoRig:
            known = size or given
            if known is None:
                raise no_size(document.source)
            return StereoRig.from_rectified(fx, fy, cx, cx, cy, baseline_m, known)

        return StoredFile(ORB_SLAM, document.source, build=build)
    if "Camera2.fx" not in values:
        raise CalibrationError(f"{ORB_SLAM} of one camera", value=1, limit=2, remedy="give those of a stereo camera")
    T_left_right = rigid(entry(values, "Stereo.T_c1_c2"), "Stereo.T_c1_c2")
    cameras = tuple(_camera(values, name, model, size) for name in ("Camera1", "Camera2"))
    return StoredFile(ORB_SLAM, document.source, cameras, inverse(pose_of(T_left_right)))


def _camera(values: Mapping[str, Any], name: str, model: str, size: Size | None) -> StoredCamera:
    fx, fy, cx, cy = (_number(values, f"{name}.{key}") for key in ("fx", "fy", "cx", "cy"))
    D = [_number(values, f"{name}.{key}") for key in _COEFFICIENTS[model]]
    if model == "PinHole":
        D.append(_number(values, f"{name}.k3") if f"{name}.k3" in values else 0.0)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    return StoredCamera(name, K, "plumb_bob" if model == "PinHole" else "equidistant", np.array(D), size)


def _number(values: Mapping[str, Any], key: str) -> float:
    return number(entry(values, key), key)


def _whole(values: Mapping[str, Any], key: str) -> int:
    return whole(entry(values, key), key)

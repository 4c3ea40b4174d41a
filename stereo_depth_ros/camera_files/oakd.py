# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibrations of OAK cameras: the JSON of DepthAI's EEPROM, and that of stereodemo.

Translations are in centimeters; a camera's extrinsics take it to the camera of ``toCameraSocket``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.stored import Pose, Size, StoredCamera, StoredFile
from stereo_depth_ros.camera_files.values import inverse, rotation
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry, number, numbers, whole
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.rig import StereoRig

__all__ = ["DEPTHAI", "STEREODEMO", "is_depthai", "is_stereodemo", "read_depthai", "read_stereodemo"]

DEPTHAI, STEREODEMO = "DepthAI calibration", "stereodemo calibration"
_LEFT, _RIGHT, _NO_SOCKET = 1, 2, -1  # CAM_B and CAM_C
_PERSPECTIVE, _FISHEYE = 0, 1
_MOST_LINKS = 10


def is_depthai(document: Document) -> bool:
    """Whether the document is that of DepthAI."""
    return "cameraData" in document.values


def read_depthai(document: Document) -> StoredFile:
    """The cameras of the stereo pair: those that it names, else those of the sockets B and C.

    Raises:
        CalibrationError: a camera or a link between the two is missing, or a value is not a number.
    """
    cameras = _cameras(document.values["cameraData"])
    stereo = document.values.get("stereoRectificationData")
    names = ("leftCameraSocket", "rightCameraSocket")
    named = [stereo[name] for name in names if isinstance(stereo.get(name), int)] if isinstance(stereo, Mapping) else []
    left, right = [int(socket) for socket in named] if len({*named} & cameras.keys()) == 2 else [_LEFT, _RIGHT]
    if missing := [socket for socket in (left, right) if socket not in cameras]:
        raise CalibrationError(
            f"{DEPTHAI} without the camera of socket {missing[0]}, it has {', '.join(map(str, cameras)) or 'none'}",
            value=sorted(cameras),
            limit=(left, right),
            remedy="give the calibration of a stereo camera",
        )
    pose = _pose(cameras, left, right)
    stored = _camera(cameras[left], f"socket {left}"), _camera(cameras[right], f"socket {right}")
    return StoredFile(DEPTHAI, document.source, stored, pose, numbered=True, scales=True)


def is_stereodemo(document: Document) -> bool:
    """Whether the document is that of stereodemo, of a rectified pair."""
    return {"baseline_meters", "fx", "cx0", "cx1"} <= document.values.keys()


def read_stereodemo(document: Document) -> StoredFile:
    """The rig of rectified images.

    Raises:
        CalibrationError: a value is missing or not a number.
    """
    names = ("fx", "fy", "cx0", "cx1", "cy", "baseline_meters")
    fx, fy, cx_left, cx_right, cy, baseline_m = (number(entry(document.values, name), name) for name in names)
    width, height = (whole(entry(document.values, name), name) for name in ("width", "height"))

    def build(_: Size | None) -> StereoRig:
        return StereoRig.from_rectified(fx, fy, cx_left, cx_right, cy, baseline_m, (width, height))

    return StoredFile(STEREODEMO, document.source, build=build)


def _cameras(data: Any) -> dict[int, Any]:
    """Camera by socket, of a list of pairs or of a mapping."""
    pairs = list(data.items()) if isinstance(data, Mapping) else data
    if not isinstance(pairs, list) or not all(isinstance(pair, (list, tuple)) and len(pair) == 2 for pair in pairs):
        raise CalibrationError(
            f"{DEPTHAI}, but cameraData is not a list of sockets and cameras", remedy="export it again"
        )
    try:
        return {int(socket): camera for socket, camera in pairs}
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f"{DEPTHAI} with a socket that is not a number", remedy="export it again") from error


def _camera(values: Any, name: str) -> StoredCamera:
    kind = entry(values, "cameraType") if "cameraType" in values else _PERSPECTIVE
    if kind not in (_PERSPECTIVE, _FISHEYE):
        raise CalibrationError(
            f"{DEPTHAI} with a camera of cameraType {quoted(kind)} ({name})",
            value=kind,
            limit=(_PERSPECTIVE, _FISHEYE),
            remedy="calibrate it as perspective or fisheye",
        )
    K = numbers(entry(values, "intrinsicMatrix"), f"{name}.intrinsicMatrix", 9).reshape(3, 3)
    D = numbers(entry(values, "distortionCoeff"), f"{name}.distortionCoeff", 4, 5, 8, 12, 14)
    size = whole(entry(values, "width"), f"{name}.width"), whole(entry(values, "height"), f"{name}.height")
    if kind == _FISHEYE:
        return StoredCamera(name, K, "equidistant", D[:4], size)
    model = "plumb_bob" if D.size <= 5 else "rational_polynomial"
    return StoredCamera(name, K, model, np.append(D, 0.0) if D.size == 4 else D, size)


def _pose(cameras: Mapping[int, Any], left: int, right: int) -> Pose:
    """From left to right along the links in either direction."""
    forward, backward = _along_links(cameras, left, right), _along_links(cameras, right, left)
    if forward is None and backward is None:
        raise CalibrationError(
            f"{DEPTHAI} without extrinsics from socket {left} to {right}",
            value=left,
            remedy="calibrate the stereo pair",
        )
    return forward if forward is not None else inverse(backward)  # type: ignore[arg-type]


def _along_links(cameras: Mapping[int, Any], start: int, end: int) -> Pose | None:
    R, T, socket = np.identity(3), np.zeros(3), start
    for _ in range(_MOST_LINKS):
        if socket == end:
            return R, T
        link = entry(cameras[socket], "extrinsics") if socket in cameras else {}
        following = link.get("toCameraSocket", _NO_SOCKET) if isinstance(link, Mapping) else _NO_SOCKET
        if not isinstance(following, int) or following not in cameras or not link.get("rotationMatrix"):
            return None
        name = f"socket {socket}.extrinsics"
        step = rotation(entry(link, "rotationMatrix"), f"{name}.rotationMatrix")
        shift = [number(entry(link, "translation", axis), f"{name}.translation.{axis}") for axis in "xyz"]
        R, T, socket = step @ R, step @ T + np.array(shift) / 100, following
    return None

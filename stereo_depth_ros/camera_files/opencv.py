# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matrices of OpenCV's FileStorage, YAML, XML or JSON: intrinsics of one camera or of both, R and T, rectification.

There is no standard of the names; those of OpenCV's own programs and of most others are known, each with a mark of
the camera: M1 and M2, cameraMatrixLeft and cameraMatrixRight, K_l and K_r, LEFT.K and RIGHT.K.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.stored import Pose, Size, StoredCamera, StoredFile
from stereo_depth_ros.camera_files.values import image_size, matrix, rotation
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import number, whole
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64

__all__ = ["OPENCV", "is_opencv", "read_opencv"]

OPENCV = "OpenCV FileStorage"
_SIDES = (("left", "right"), ("l", "r"), ("1", "2"), ("0", "1"))
_K = ("m", "k", "cameramatrix", "cammatrix", "cam", "camera", "mtx", "intrinsic", "intrinsics", "intrinsicmatrix")
_D = ("d", "distcoeffs", "distcoeff", "dist", "distortion", "distortioncoefficients", "distortioncoeffs", "distcoefs")
_R_RECTIFIED = ("r", "rect", "rectification", "rectificationmatrix", "rectifyrotation")
_P = ("p", "proj", "projection", "projectionmatrix")
_R, _T = (
    ("r", "rot", "rmat", "rotation", "rotationmatrix"),
    (*("t", "trans", "tvec", "translation", "translationvector", "tmat"),),
)
_SIZES = ("imagesize", "imgsize", "size", "resolution", "imageresolution", "cameraresolution", "calibimagesize")
_WIDTHS = (("imagewidth", "imageheight"), ("width", "height"), ("leftwidth", "leftheight"), ("w", "h"))
_MODELS = {
    "plumb_bob": "plumb_bob",
    "radtan": "plumb_bob",
    "pinhole": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "fisheye": "equidistant",
    "equidistant": "equidistant",
}
_MODEL_KEYS = ("distortionmodel", "cameramodel", "model", "lensmodel")
_COUNTS = {
    0: "plumb_bob",
    5: "plumb_bob",
    8: "rational_polynomial",
    12: "rational_polynomial",
    14: "rational_polynomial",
}


def is_opencv(document: Document) -> bool:
    """Whether the document holds a camera matrix, or R and T."""
    values = _by_name(document.values)
    return _sides(values, _K, 9) is not None or _one(values, _K, 9) is not None or _has_pose(values)


def read_opencv(document: Document) -> StoredFile:
    """The cameras and the pose that the document holds.

    Raises:
        CalibrationError: a value is missing or not a number, or four coefficients that may be of either model.
    """
    values = _by_name(document.values)
    pose = _pose(values) if _has_pose(values) else None
    names = _sides(values, _K, 9)
    if names is not None:
        D = _sides(values, _D) or ("", "")
        cameras = _camera(values, names[0], D[0]), _camera(values, names[1], D[1])
        return StoredFile(OPENCV, document.source, cameras, pose, _rectification(values))
    name = _one(values, _K, 9)
    cameras_of_one = (_camera(values, name, _one(values, _D) or ""),) if name is not None else ()
    return StoredFile(OPENCV, document.source, cameras_of_one, pose, _rectification(values))


def _by_name(values: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
    """Key and value by the key in small letters and digits."""
    return {re.sub("[^a-z0-9]", "", key.lower()): (key, value) for key, value in values.items()}


_Values = Mapping[str, tuple[str, Any]]


def _has_pose(values: _Values) -> bool:
    return _one(values, _R, 3, 9) is not None and _one(values, _T, 3) is not None


def _sides(values: _Values, names: tuple[str, ...], *counts: int) -> tuple[str, str] | None:
    """The names of a matrix of the left and of the right camera, with the mark of the camera behind or before."""
    for marks in _SIDES:
        for name in names:
            for pair in ((name + marks[0], name + marks[1]), (marks[0] + name, marks[1] + name)):
                if all(_is_matrix(values, key, counts) for key in pair):
                    return pair
    return None


def _one(values: _Values, names: tuple[str, ...], *counts: int) -> str | None:
    return next((name for name in names if _is_matrix(values, name, counts)), None)


def _is_matrix(values: _Values, name: str, counts: tuple[int, ...]) -> bool:
    """Whether there is a list or matrix of this name, with one of the counts of values; damaged values count."""
    if name not in values:
        return False
    value = values[name][1]
    data = value.get("data") if isinstance(value, Mapping) else value
    if not isinstance(data, list):
        return False
    return not counts or sum(len(row) if isinstance(row, list) else 1 for row in data) in counts


def _pose(values: _Values) -> Pose:
    R, T = (_one(values, _R, 3, 9) or "", _one(values, _T, 3) or "")
    return rotation(values[R][1], values[R][0]), matrix(values[T][1], values[T][0], 3)


def _rectification(values: _Values) -> tuple[tuple[F64, F64], tuple[F64, F64]] | None:
    """R and P of both cameras; None where one is missing."""
    R, P = _sides(values, _R_RECTIFIED, 9), _sides(values, _P, 12)
    if R is None or P is None:
        return None
    left, right = (
        (rotation(values[r][1], values[r][0]), matrix(values[p][1], values[p][0], 12).reshape(3, 4))
        for r, p in zip(R, P, strict=True)
    )
    return left, right


def _camera(values: _Values, K: str, D: str) -> StoredCamera:
    key, value = values[K]
    coefficients = matrix(values[D][1], values[D][0]) if D else np.zeros(5)
    model = _model(values, coefficients, values[D][0] if D else "D")
    return StoredCamera(key, matrix(value, key, 9).reshape(3, 3), model, coefficients, _size(values))


def _model(values: _Values, D: F64, name: str) -> str:
    """The distortion model: as the file states it, or by the count of coefficients."""
    for key in _MODEL_KEYS:
        if key in values and isinstance(values[key][1], str):
            stated = values[key][1]
            if stated.lower() not in _MODELS:
                raise CalibrationError(
                    f"{OPENCV} with {values[key][0]} {quoted(stated)}",
                    value=stated,
                    limit=tuple(_MODELS),
                    remedy="write one of them",
                )
            model = _MODELS[stated.lower()]
            return "rational_polynomial" if model == "plumb_bob" and D.size > 5 else model
    if "fisheyemodel" in values or "fisheye" in values:
        key = "fisheyemodel" if "fisheyemodel" in values else "fisheye"
        stated = values[key][1]
        return "equidistant" if stated is True or number(float(stated or 0), key) else "plumb_bob"
    if D.size == 4 and D.any():
        raise CalibrationError(
            f"{name} has 4 coefficients, which may be those of a pinhole (k1, k2, p1, p2) or of a fisheye (k1 to k4)",
            value=D.size,
            limit=("plumb_bob", "equidistant"),
            remedy="add the row `distortion_model: plumb_bob` or `distortion_model: equidistant` to the file",
        )
    if D.size != 4 and D.size not in _COUNTS:
        raise CalibrationError(
            f"{name} has {D.size} coefficients, OpenCV has 4, 5, 8, 12 or 14",
            value=D.size,
            limit=(4, 5, 8, 12, 14),
            remedy="write all of them",
        )
    return _COUNTS.get(D.size, "plumb_bob")


def _size(values: _Values) -> Size | None:
    for width, height in _WIDTHS:
        if width in values and height in values:
            return whole(values[width][1], values[width][0]), whole(values[height][1], values[height][0])
    for key in _SIZES:
        if key in values:
            name, value = values[key]
            if isinstance(value, Mapping) and {"width", "height"} <= value.keys():
                return whole(value["width"], name), whole(value["height"], name)
            if isinstance(value, list) and len(value) == 2:
                return image_size(value, name)
    return None

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera files of ROS: the YAML of ``camera_calibration``, and its ost.txt or ost.ini, the INI of Videre."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.stored import StoredCamera, StoredFile
from stereo_depth_ros.core.camera_yaml import camera_from_entries
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64

__all__ = ["INI", "YAML", "is_ini", "is_yaml", "read_ini", "read_yaml"]

YAML, INI = "camera_calibration YAML", "Videre ini"
_SHAPES = {"camera matrix": (9,), "distortion": (5, 8), "rectification": (9,), "projection": (12,)}


def is_yaml(document: Document) -> bool:
    """Whether the document is the YAML of camera_calibration."""
    return {"camera_matrix", "projection_matrix"} <= document.values.keys()


def read_yaml(document: Document) -> StoredFile:
    """One camera."""
    camera = camera_from_entries(document.values)
    size = camera.width, camera.height
    stored = StoredCamera("", camera.K, camera.distortion_model, camera.D, size, camera.R, camera.P)
    return StoredFile(YAML, document.source, (stored,))


def is_ini(document: Document) -> bool:
    """Whether the document is that of camera_calibration_parsers."""
    return "[image]" in document.text


def read_ini(document: Document) -> StoredFile:
    """One camera, or both, left first, as in the ost.txt of a stereo calibration.

    Raises:
        CalibrationError: a value is missing or not a number.
    """
    cameras, size = [], {}
    for name, values in _sections(document.text):
        if name == "image":
            size = {key: _numbers(values, key, (1,)) for key in ("width", "height")}
        elif name != "externals":
            if not size:
                raise CalibrationError("lacks the section [image] before that of a camera", remedy="write it again")
            matrices = {key: _numbers(values, key, counts) for key, counts in _SHAPES.items()}
            K, D, R, P = matrices.values()
            model = "plumb_bob" if D.size == 5 else "rational_polynomial"
            width, height = (int(value[0]) for value in size.values())
            cameras.append(
                StoredCamera(name, K.reshape(3, 3), model, D, (width, height), R.reshape(3, 3), P.reshape(3, 4))
            )
    return StoredFile(INI, document.source, tuple(cameras))


def _sections(text: str) -> Iterator[tuple[str, dict[str, list[str]]]]:
    """Name of each section, and its words by key; a row that does not begin with a number is a key."""
    name, values, key = "", {}, ""  # type: tuple[str, dict[str, list[str]], str]
    for row in text.splitlines():
        row = row.strip()
        if not row or row[0] in "#;":
            continue
        if row[0] == "[" and row[-1] == "]":
            if name:
                yield name, values
            name, values, key = row[1:-1].strip(), {}, ""
        elif re.match(r"[-+.\d]", row):
            values.setdefault(key, []).extend(row.split())
        else:
            key = row.lower()
    if name:
        yield name, values


def _numbers(values: dict[str, list[str]], key: str, counts: tuple[int, ...]) -> F64:
    words = values.get(key, [])
    try:
        found = np.array([float(word) for word in words], np.float64)
    except ValueError as error:
        raise CalibrationError(
            f"a value is not a number ({key}: {quoted(words[0])})", remedy="write numbers"
        ) from error
    if found.size not in counts or not np.isfinite(found).all() or (counts == (1,) and not 1 <= found[0] <= 65535):
        raise CalibrationError(
            f"{key} has {found.size} numbers, not {' or '.join(map(str, counts))}"
            if found.size not in counts
            else f"{key} = {' '.join(words)[:80]} is not possible",
            value=found.size,
            limit=counts,
            remedy="write all of them, plumb_bob has 5 coefficients, rational_polynomial 8",
        )
    return found

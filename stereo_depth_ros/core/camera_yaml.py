# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera model to and from the YAML text of ROS's ``camera_calibration``, one camera per file."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry, numbers, whole
from stereo_depth_ros.core.safe_yaml import YamlError, load_yaml
from stereo_depth_ros.core.types import F64

__all__ = ["camera_from_entries", "camera_from_yaml", "camera_to_yaml"]

_MATRICES = ("camera_matrix", "distortion_coefficients", "rectification_matrix", "projection_matrix")
_KEYS = (
    "image_width, image_height, distortion_model, "
    "and data of camera_matrix, distortion_coefficients, rectification_matrix, projection_matrix"
)


def camera_from_yaml(text: str, source: str = "camera file") -> CameraModel:
    """The camera of a YAML text; the format has no optical frame, so ``frame_id`` is empty.

    Without distortion_model it is plumb_bob, as in ROS; where only P is set, the images are taken as rectified.

    Args:
        text: the content of a file.
        source: its path, the subject of errors.

    Raises:
        CalibrationError: not plain YAML, or keys or values are missing.
    """
    try:
        entries = load_yaml(text)
    except YamlError as error:
        raise CalibrationError(
            f"is not plain YAML ({error})",
            subject=source,
            remedy="export it in the format of camera_calibration",
        ) from error
    try:
        return camera_from_entries(entries)
    except CalibrationError as error:
        raise error.about(source) from error


def camera_from_entries(entries: Any) -> CameraModel:
    """The camera of the plain data of such a YAML text.

    Raises:
        CalibrationError: keys or values are missing, or are not numbers.
    """
    if not isinstance(entries, Mapping):
        raise CalibrationError("is not a camera file, it has no keys", limit=_KEYS, remedy=f"a camera file has {_KEYS}")
    width, height = (whole(entry(entries, name), name, 0) for name in ("image_width", "image_height"))
    K, D, R, P = (numbers(entry(entries, name, "data"), name) for name in _MATRICES)
    model = entries.get("distortion_model")
    return CameraModel(width, height, "plumb_bob" if model is None else str(model), K, D, R, P).described()


def camera_to_yaml(camera: CameraModel, camera_name: str) -> str:
    """The YAML text of a camera, every number with all its digits."""
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style, yaml.width = None, 1000  # each list of numbers on one line
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    entries: dict[str, Any] = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": camera_name,
        "camera_matrix": _matrix(camera.K),
        "distortion_model": camera.distortion_model,
        "distortion_coefficients": _matrix(camera.D.reshape(1, -1)),
        "rectification_matrix": _matrix(camera.R),
        "projection_matrix": _matrix(camera.P),
    }
    text = io.StringIO()
    yaml.dump(entries, text)
    return text.getvalue()


def _matrix(values: F64) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sensor.yaml of EuRoC, one camera, in the ASL layout.

Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016.
"""

from __future__ import annotations

from stereo_depth_ros.camera_files.documents import Document
from stereo_depth_ros.camera_files.stored import StoredCamera, StoredFile
from stereo_depth_ros.camera_files.values import camera_matrix, image_size, matrix, rigid
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry
from stereo_depth_ros.core.quoted import quoted

__all__ = ["EUROC", "is_sensor", "read_sensor"]

EUROC = "EuRoC sensor.yaml"
_MODELS = {"radial-tangential": "plumb_bob", "equidistant": "equidistant"}


def is_sensor(document: Document) -> bool:
    """Whether the document is a sensor.yaml of a camera."""
    return {"T_BS", "intrinsics"} <= document.values.keys()


def read_sensor(document: Document) -> StoredFile:
    """One camera with its pose in the body.

    Raises:
        CalibrationError: a value is missing or not a number, or another distortion model.
    """
    values = document.values
    K, size = camera_matrix(values["intrinsics"], "intrinsics"), image_size(entry(values, "resolution"), "resolution")
    model = entry(values, "distortion_model")
    if model not in _MODELS:
        raise CalibrationError(
            f"distortion_model = {quoted(model)} is not supported, supported is {' or '.join(_MODELS)}",
            value=model,
            limit=tuple(_MODELS),
            remedy="calibrate with this model",
        )
    D = matrix(entry(values, "distortion_coefficients"), "distortion_coefficients", 4)
    camera = StoredCamera("", K, _MODELS[model], D, size, body=rigid(values["T_BS"], "T_BS"))
    return StoredFile(EUROC, document.source, (camera,), numbered=True)

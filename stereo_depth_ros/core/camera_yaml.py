# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera files in the YAML format of ROS's ``camera_calibration``, one camera a file, read and written."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.files.output import write_file

__all__ = ["read_camera", "write_camera"]


def read_camera(path: str | Path) -> CameraModel:
    """The camera of a file; the format names no optical frame, so ``frame_id`` is empty.

    Raises:
        CalibrationError: the file cannot be read, is no YAML, or lacks a key or values.
    """
    try:
        entries = YAML(typ="safe", pure=True).load(Path(path))
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read ({error}): name a file of camera_calibration") from error
    except YAMLError as error:
        raise CalibrationError(
            f"{path}: is no plain YAML ({' '.join(str(error).split())}): export it in the format of camera_calibration"
        ) from error
    try:
        return CameraModel(
            width=int(entries["image_width"]),
            height=int(entries["image_height"]),
            distortion_model=str(entries["distortion_model"]),
            K=np.array(entries["camera_matrix"]["data"], np.float64),
            D=np.array(entries["distortion_coefficients"]["data"], np.float64),
            R=np.array(entries["rectification_matrix"]["data"], np.float64),
            P=np.array(entries["projection_matrix"]["data"], np.float64),
        )
    except KeyError as error:
        raise CalibrationError(
            f"{path}: lacks the key {error}: a camera file has image_width, image_height, distortion_model, "
            "and data of camera_matrix, distortion_coefficients, rectification_matrix, projection_matrix"
        ) from error
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: a value is not a number or a list of them ({error}): write numbers") from error
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


def write_camera(path: str | Path, camera: CameraModel, camera_name: str, *, overwrite: bool = False) -> None:
    """Writes a camera, every number with all its digits.

    Raises:
        OutputError: the file is there and ``overwrite`` is false, or it cannot be written.
    """
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
    write_file(Path(path), text.getvalue(), overwrite=overwrite)


def _matrix(values: F64) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}

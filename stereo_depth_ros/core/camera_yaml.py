# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera model to and from the YAML text of ROS's ``camera_calibration``, one camera per file."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.safe_yaml import YamlError, load_yaml
from stereo_depth_ros.core.types import F64

__all__ = ["camera_from_yaml", "camera_to_yaml"]

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
        return CameraModel(
            width=int(entries["image_width"]),
            height=int(entries["image_height"]),
            distortion_model=str(entries.get("distortion_model", "plumb_bob")),
            K=np.array(entries["camera_matrix"]["data"], np.float64),
            D=np.array(entries["distortion_coefficients"]["data"], np.float64),
            R=np.array(entries["rectification_matrix"]["data"], np.float64),
            P=np.array(entries["projection_matrix"]["data"], np.float64),
        ).described()
    except KeyError as error:
        raise CalibrationError(
            f"lacks the key {error}", subject=source, limit=_KEYS, remedy=f"a camera file has {_KEYS}"
        ) from error
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(
            f"a value is not a number or a list of them ({error})", subject=source, remedy="write numbers"
        ) from error
    except CalibrationError as error:
        raise error.about(source) from error


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

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""File of a light plane: plain YAML with the plane, its standard deviations, residuals and the camera."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane
from stereo_depth_ros.active.light_stripe.plane_calibration import PlaneCalibration
from stereo_depth_ros.core.camera import CameraModel, check_intrinsics
from stereo_depth_ros.core.camera_yaml import camera_from_entries, camera_to_yaml
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry, number, numbers
from stereo_depth_ros.core.safe_yaml import YamlError, load_yaml
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.files.output import write_file

__all__ = ["check_same_camera", "plane_text", "read_plane", "write_plane"]

_REMEDY = "write it with `stereo-depth calibrate-laser`"
_SAME = 1e-3  # relative difference of the intrinsics of one camera, at most


def plane_text(plane: LightPlane, camera: CameraModel, calibration: PlaneCalibration | None = None) -> str:
    """The text of the file of a light plane in the optical frame of a camera."""
    lines = [
        "# Light plane A X + B Y + C Z + D = 0 in the optical frame of the camera, meters; A, B, C are the normal.",
        "light_plane:",
        f"  normal: {json.dumps(plane.normal.tolist())}",
        f"  d_m: {json.dumps(float(plane.d_m))}",
        f"  center_m: {json.dumps(plane.center_m.tolist())}",
        f"  tilt_axes: {json.dumps(plane.tilt_axes.tolist())}",
        f"  offset_sigma_m: {json.dumps(float(plane.offset_sigma_m))}",
        f"  tilt_sigma_rad: {json.dumps([float(sigma) for sigma in plane.tilt_sigma])}",
    ]
    if calibration is not None:
        lines += ["residuals:", *(f"  {name}: {json.dumps(value)}" for name, value in calibration.residuals().items())]
    return "\n".join([*lines, "camera:", *(f"  {line}" for line in camera_to_yaml(camera, "camera").splitlines()), ""])


def write_plane(
    path: Path,
    plane: LightPlane,
    camera: CameraModel,
    calibration: PlaneCalibration | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Write the file of a light plane.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    write_file(path, plane_text(plane, camera, calibration), overwrite=overwrite, make_folders=True)


def read_plane(path: Path) -> tuple[LightPlane, CameraModel]:
    """The light plane of a file, and the camera it belongs to.

    Raises:
        CalibrationError: not such a file.
    """
    text = read_text(path, CalibrationError, "give the file of `stereo-depth calibrate-laser`")
    try:
        try:
            values = load_yaml(text)
        except YamlError as error:
            raise CalibrationError(f"is not plain YAML ({error})", remedy=_REMEDY) from error
        plane = _plane(entry(values, "light_plane"))
        camera = camera_from_entries(entry(values, "camera"))
        check_intrinsics(camera, "camera")
    except CalibrationError as error:
        raise error.about(path, error.remedy or _REMEDY) from error
    return plane, camera


def _plane(values: Any) -> LightPlane:
    normal, d_m = numbers(entry(values, "normal"), "normal", 3), number(entry(values, "d_m"), "d_m")
    length = float(np.linalg.norm(normal))
    if not length > 0:
        raise CalibrationError("normal is 0", value=normal, remedy=_REMEDY)
    plain = LightPlane.exact(normal, d_m)
    if "center_m" not in values:
        return plain
    return LightPlane(
        plain.normal,
        plain.d_m,
        numbers(values["center_m"], "center_m", 3),
        numbers(entry(values, "tilt_axes"), "tilt_axes", 6).reshape(2, 3),
        number(entry(values, "offset_sigma_m"), "offset_sigma_m"),
        tuple(numbers(entry(values, "tilt_sigma_rad"), "tilt_sigma_rad", 2)),
    )


def check_same_camera(given: CameraModel, calibrated: CameraModel, subject: str) -> None:
    """Raise CalibrationError where a light plane was calibrated with another camera than that of the images."""
    same_size = (given.width, given.height) == (calibrated.width, calibrated.height)
    difference = np.abs(given.K - calibrated.K).max() / calibrated.K[0, 0]
    if same_size and difference <= _SAME:
        return
    raise CalibrationError(
        f"the camera is {_text(given)}, the light plane was calibrated with {_text(calibrated)}",
        subject=subject,
        value=_text(given),
        limit=_text(calibrated),
        remedy="calibrate the light plane with this camera",
        settings=("laser_file", "laser"),
    )


def _text(camera: CameraModel) -> str:
    fx, fy, cx, cy = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
    return f"{camera.width}x{camera.height}, f {fx:.1f} / {fy:.1f}, c {cx:.1f} {cy:.1f} px"

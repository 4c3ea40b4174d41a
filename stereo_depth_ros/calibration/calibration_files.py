# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a calibration: left.yaml and right.yaml for ROS, calibration.json and calibration.txt for people."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.projection import parameter_names
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_yaml import camera_to_yaml
from stereo_depth_ros.core.errors import CalibrationError

__all__ = ["save_calibration", "write_camera"]


def save_calibration(calibration: StereoCalibration, folder: Path) -> None:
    """Writes the files into a folder, which is made where it is not there.

    Raises:
        CalibrationError: they cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "calibration.json").write_text(json.dumps(calibration.to_json(), indent=2) + "\n", encoding="utf-8")
        (folder / "calibration.txt").write_text("\n".join(_report(calibration)) + "\n", encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{folder}: cannot be written ({error.strerror}): choose another folder") from error
    write_camera(folder / "left.yaml", calibration.rig.left, "left")
    write_camera(folder / "right.yaml", calibration.rig.right, "right")


def write_camera(path: Path, camera: CameraModel, camera_name: str) -> None:
    """Writes a camera file in the format of ``camera_calibration``.

    Raises:
        CalibrationError: the file cannot be written.
    """
    try:
        path.write_text(camera_to_yaml(camera, camera_name), encoding="utf-8")
    except OSError as error:
        raise CalibrationError(
            f"cannot be written ({error})", subject=str(path), remedy="choose another folder"
        ) from error


def _report(calibration: StereoCalibration) -> Iterator[str]:
    c = calibration
    yield f"{c.model}, {c.size[0]}x{c.size[1]}, {len(c.views)} views used, {len(c.dropped)} dropped"
    yield f"baseline {1e3 * c.baseline_m:.3f} +- {1e3 * c.baseline_sigma_m:.3f} mm"
    yield f"rms left {c.left.rms_px:.4f} px, right {c.right.rms_px:.4f} px, both {c.rms_stereo_px:.4f} px"
    yield f"rms of each camera alone: left {c.left.rms_alone_px:.4f} px, right {c.right.rms_alone_px:.4f} px"
    yield f"rows after rectification: rms {c.epipolar_rms_px:.4f} px"
    for side, camera in (("left", c.left), ("right", c.right)):
        yield ""
        yield f"{side}: value and standard deviation"
        values = (camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], *camera.D)
        for name, value, sigma in zip(parameter_names(c.model), values, camera.sigmas, strict=True):
            yield f"  {name}  {value:.8g} +- {sigma:.3g}"
    yield ""
    yield f"T {c.T.tolist()} m +- {c.T_sigma_m.tolist()}"
    yield f"R {c.R.tolist()}, about x, y, z +- {c.R_sigma_deg.tolist()} deg"
    yield ""
    for view in c.views:
        yield (
            f"{view.name}: rms left {view.rms_left:.3f} px, right {view.rms_right:.3f} px, rows {view.rms_rows:.3f} px"
        )
    yield from (f"dropped {view.name}: {view.reason}" for view in c.dropped)
    yield from (f"warning: {text}" for text in c.warnings)
    yield from (f"to do better: {text}" for text in c.coverage.missing)

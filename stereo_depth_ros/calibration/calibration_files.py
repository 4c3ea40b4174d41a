# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of a calibration: camera infos left.yaml and right.yaml, report calibration.json and calibration.txt."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.projection import parameter_names
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_yaml import camera_to_yaml
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.files.output import check_outputs, write_file

__all__ = ["calibration_files", "save_calibration", "write_calibration_files", "write_camera"]


def calibration_files(folder: Path) -> list[Path]:
    """Paths that :func:`save_calibration` writes in a folder."""
    return [folder / name for name in ("left.yaml", "right.yaml", "calibration.json", "calibration.txt")]


def save_calibration(calibration: StereoCalibration, folder: Path, *, overwrite: bool = False) -> None:
    """Write the files into a folder, which is created if missing.

    Args:
        calibration: the result.
        folder: the output folder.
        overwrite: replace the files that are there.

    Raises:
        OutputError: one of the files exists and ``overwrite`` is false (then none is written), or cannot be written.
    """
    write_calibration_files(folder, calibration.to_json(), _report(calibration), calibration.rig, overwrite=overwrite)


def write_calibration_files(
    folder: Path, values: Any, report: Iterable[str], rig: StereoRig, right_comment: str = "", *, overwrite: bool
) -> None:
    """Write the files of :func:`calibration_files`.

    Args:
        folder: the output folder, which is created if missing.
        values: plain data for calibration.json.
        report: lines of calibration.txt.
        rig: both cameras.
        right_comment: lines of YAML comments at the beginning of right.yaml.
        overwrite: replace the files that are there.

    Raises:
        OutputError: one of the files exists and ``overwrite`` is false (then none is written), or cannot be written.
    """
    paths = left_path, right_path, values_path, report_path = calibration_files(folder)
    check_outputs(paths, overwrite=overwrite)
    text = json.dumps(values, indent=2)
    write_file(values_path, f"{text}\n", overwrite=overwrite, make_folders=True)
    write_file(report_path, "\n".join(report) + "\n", overwrite=overwrite)
    write_camera(left_path, rig.left, "left", overwrite=overwrite)
    write_file(right_path, right_comment + camera_to_yaml(rig.right, "right"), overwrite=overwrite)


def write_camera(path: Path, camera: CameraModel, camera_name: str, *, overwrite: bool = False) -> None:
    """Write a camera file in the format of ``camera_calibration``, every number with all its digits.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    write_file(path, camera_to_yaml(camera, camera_name), overwrite=overwrite)


def _report(calibration: StereoCalibration) -> Iterator[str]:
    c = calibration
    yield f"{c.model}, {c.size[0]}x{c.size[1]}, {len(c.views)} views used, {len(c.dropped)} dropped"
    yield f"baseline {1e3 * c.baseline_m:.3f} +- {1e3 * c.baseline_sigma_m:.3f} mm"
    yield f"rms left {c.left.rms_px:.4f} px, right {c.right.rms_px:.4f} px, both {c.rms_stereo_px:.4f} px"
    yield f"rms of each camera alone: left {c.left.rms_alone_px:.4f} px, right {c.right.rms_alone_px:.4f} px"
    yield f"row error after rectification: rms {c.epipolar_rms_px:.4f} px"
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
    yield from (f"to improve: {text}" for text in c.coverage.missing)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""File of the axis of a turntable: plain YAML."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from stereo_depth_ros.active.light_stripe.motion import Turntable
from stereo_depth_ros.active.light_stripe.turntable import TurntableCalibration
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.plain_values import entry, numbers
from stereo_depth_ros.core.safe_yaml import YamlError, load_yaml
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.files.output import write_file

__all__ = ["read_turntable", "write_turntable"]

_REMEDY = "write it with `stereo-depth calibrate-turntable`"


def write_turntable(path: Path, calibration: TurntableCalibration, *, overwrite: bool = False) -> None:
    """Write the file of the axis of a turntable.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    table, (normal, d_m) = calibration.turntable, calibration.table_plane
    lines = [
        "# Axis of a turntable in the optical frame of the camera, meters; angles are right-handed about it.",
        "turntable:",
        f"  axis: {json.dumps(table.axis.tolist())}",
        f"  point_m: {json.dumps(table.point_m.tolist())}",
        f"  axis_sigma_deg: {json.dumps(calibration.axis_sigma_deg)}",
        f"  point_sigma_m: {json.dumps(calibration.point_sigma_m)}",
        f"  rms_px: {json.dumps(calibration.rms_px)}",
        f"  angles_deg: {json.dumps(np.degrees(calibration.angles_rad).tolist())}",
        "# Plane through the targets, normal X + d = 0",
        "table_plane:",
        f"  normal: {json.dumps(normal.tolist())}",
        f"  d_m: {json.dumps(d_m)}",
    ]
    write_file(path, "\n".join([*lines, ""]), overwrite=overwrite, make_folders=True)


def read_turntable(path: Path) -> Turntable:
    """The axis of a file.

    Raises:
        CalibrationError: not such a file.
    """
    text = read_text(path, CalibrationError, "give the file of `stereo-depth calibrate-turntable`")
    try:
        try:
            values = entry(load_yaml(text), "turntable")
        except YamlError as error:
            raise CalibrationError(f"is not plain YAML ({error})", remedy=_REMEDY) from error
        axis, point = (numbers(entry(values, name), name, 3) for name in ("axis", "point_m"))
        length = float(np.linalg.norm(axis))
        if not length > 0:
            raise CalibrationError("axis is 0", value=axis, remedy=_REMEDY)
    except CalibrationError as error:
        raise error.about(path, error.remedy or _REMEDY) from error
    return Turntable(axis / length, point)

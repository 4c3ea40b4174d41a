# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table of the motion of a scan: a CSV file with a row for each image, or over time."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stereo_depth_ros.active.light_stripe.motion import MotionTrack
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.core.types import F64

__all__ = ["MotionTable", "read_motion_table"]

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
# Columns of a value: the kind of motion, and the factor to meters or radians
_COLUMNS: Mapping[str, tuple[str, float]] = {
    "position_m": ("linear", 1.0),
    "position_mm": ("linear", 1e-3),
    "angle_deg": ("turntable", float(np.pi / 180)),
    "angle_rad": ("turntable", 1.0),
}
_REMEDY = (
    f"write a header of image or stamp_s, and one of {', '.join(_COLUMNS)}, or {','.join(_POSE)}, and numbers below it"
)
_LARGEST_S = 9e9  # nanoseconds of it are an int64


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Values of a motion.

    Attributes:
        kind: "linear", "turntable" or "pose".
        by_image: value by the name of an image; empty where the table is over time.
        track: values over time; empty where the table is by image.
    """

    kind: str
    by_image: dict[str, F64] = field(default_factory=dict)
    track: MotionTrack = field(default_factory=MotionTrack)


def read_motion_table(path: Path) -> MotionTable:
    """Reads a table.

    Raises:
        BagError: not a table of the columns image or stamp_s, and those of one kind of motion.
    """
    rows = list(csv.reader(read_text(path, BagError, _REMEDY).splitlines(), skipinitialspace=True))
    rows = [row for row in rows if row and not row[0].startswith("#")]
    header = [name.strip().lower() for name in rows[0]] if rows else []
    if len(rows) < 2 or header[0] not in ("image", "stamp_s"):
        raise _refused(path, "is not a table of a motion", header)
    names = tuple(header[1:])
    if names == _POSE:
        kind, scale = "pose", 1.0
    elif len(names) == 1 and names[0] in _COLUMNS:
        kind, scale = _COLUMNS[names[0]]
    else:
        raise _refused(path, f"has the columns {', '.join(map(quoted, names)) or 'of nothing'} of a motion", names)
    table = MotionTable(kind)
    for number, row in enumerate(rows[1:], start=2):
        try:
            value = scale * np.array([float(cell) for cell in row[1:]])
            key = float(row[0]) if header[0] == "stamp_s" else 0.0
        except ValueError as error:
            raise _refused(path, f"row {number} holds what is not a number", row) from error
        if len(row) != len(header) or not np.isfinite(value).all() or not abs(key) < _LARGEST_S:
            raise _refused(path, f"row {number} has not {len(header)} finite values", row)
        if kind == "pose" and not 0.5 < float(np.linalg.norm(value[3:])) < 2:
            raise _refused(path, f"row {number} has a quaternion that is not of length 1", row)
        if header[0] == "stamp_s":
            table.track.add(round(key * 1e9), value)
        elif row[0] in table.by_image:
            raise _refused(path, f"row {number} names {quoted(row[0])} again", row[0])
        else:
            table.by_image[row[0]] = value
    return table


def _refused(path: Path, problem: str, value: object) -> BagError:
    return BagError(problem, subject=str(path), value=value, remedy=_REMEDY, settings=("motion",))

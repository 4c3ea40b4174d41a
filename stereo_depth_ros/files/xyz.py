# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""XYZ files of points: text with coordinates and colors in each line, which most programs of point clouds read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.files.output import write_file

__all__ = ["write_xyz"]


def write_xyz(path: Path, points_m: F32 | F64, rgb: U8, *, overwrite: bool = False) -> None:
    """Write points as lines ``x y z red green blue``.

    Args:
        path: the file; missing folders are created.
        points_m: float (N, 3), written with five decimals, 0.01 mm.
        rgb: uint8 (N, 3) RGB.
        overwrite: replace a file that is there.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    rows = zip(np.asarray(points_m, np.float64).tolist(), rgb.tolist(), strict=True)
    text = "".join(f"{x:.5f} {y:.5f} {z:.5f} {r} {g} {b}\n" for (x, y, z), (r, g, b) in rows)
    write_file(path, text, overwrite=overwrite, make_folders=True)

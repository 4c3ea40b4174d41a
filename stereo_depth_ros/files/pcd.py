# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PCD files of points (version 0.7 of the Point Cloud Library), organized like an image where the points are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.files.output import write_file

__all__ = ["write_pcd"]


def write_pcd(
    path: Path,
    points_m: F32 | F64,
    values: Mapping[str, npt.NDArray[Any]] | None = None,
    *,
    rgb: U8 | None = None,
    overwrite: bool = False,
) -> None:
    """Write points, binary and little-endian.

    Args:
        path: the file; missing folders are created.
        points_m: float (H, W, 3) of an organized cloud, NaN where there is no point, or (N, 3); stored as float32.
        values: further float fields by name, (H, W) or (N,), such as intensity.
        rgb: uint8 (H, W, 3) or (N, 3) RGB, stored as the packed field rgb.
        overwrite: replace a file that is there.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    height, width = points_m.shape[:2] if points_m.ndim == 3 else (1, len(points_m))
    columns = dict(zip("xyz", np.asarray(points_m, "<f4").reshape(-1, 3).T, strict=True))
    columns |= {name: np.asarray(value, "<f4").ravel() for name, value in (values or {}).items()}
    if rgb is not None:
        r, g, b = rgb.reshape(-1, 3).astype("<u4").T
        columns["rgb"] = (r << 16 | g << 8 | b).astype("<u4").view("<f4")
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(columns)}",
        f"SIZE{' 4' * len(columns)}",
        f"TYPE{' F' * len(columns)}",
        f"COUNT{' 1' * len(columns)}",
        f"WIDTH {width}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {width * height}",
        "DATA binary",
        "",
    ]
    table = np.stack([*columns.values()], axis=1)
    write_file(path, "\n".join(header).encode() + table.tobytes(), overwrite=overwrite, make_folders=True)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PLY files of points (Stanford polygon format 1.0), which MeshLab, CloudCompare and Open3D read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.files.output import write_file

__all__ = ["write_ply"]


def write_ply(
    path: Path,
    points_m: F64,
    values: Mapping[str, npt.NDArray[Any]] | None = None,
    *,
    text: bool = False,
    overwrite: bool = False,
) -> None:
    """Write points as vertices.

    Args:
        path: the file; missing folders are created.
        points_m: float64 (N, 3), stored as float32 x, y, z.
        values: further float properties by name, (N,), such as intensity.
        text: as text instead of little-endian binary.
        overwrite: replace a file that is there.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    names = ["x", "y", "z", *(values or {})]
    columns = [*points_m.T, *(values or {}).values()]
    table = np.stack([np.asarray(column, "<f4") for column in columns], axis=1)
    header = [
        "ply",
        f"format {'ascii' if text else 'binary_little_endian'} 1.0",
        "comment meters",
        f"element vertex {len(table)}",
        *(f"property float {name}" for name in names),
        "end_header",
        "",
    ]
    rows = (
        "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in table).encode() if text else table.tobytes()
    )
    write_file(path, "\n".join(header).encode() + rows, overwrite=overwrite, make_folders=True)

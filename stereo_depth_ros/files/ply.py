# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PLY files of points and meshes (Stanford polygon format 1.0), which MeshLab, CloudCompare and Open3D read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.files.output import write_file

__all__ = ["write_ply"]


def write_ply(
    path: Path,
    points_m: F32 | F64,
    values: Mapping[str, npt.NDArray[Any]] | None = None,
    *,
    triangles: npt.NDArray[np.int32] | None = None,
    text: bool = False,
    overwrite: bool = False,
) -> None:
    """Write points as vertices, and triangles as faces.

    Args:
        path: the file; missing folders are created.
        points_m: float (N, 3), stored as float32 x, y, z.
        values: further properties by name, (N,): uint8, such as red, stays so, others become float.
        triangles: int32 (M, 3), vertices of each triangle; None writes points without faces.
        text: as text instead of little-endian binary.
        overwrite: replace a file that is there.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it cannot be written.
    """
    columns = {**dict(zip("xyz", points_m.T, strict=True)), **(values or {})}
    kinds = {name: "u1" if column.dtype == np.uint8 else "<f4" for name, column in columns.items()}
    vertices = np.empty(len(points_m), [*kinds.items()])
    for name, column in columns.items():
        vertices[name] = column
    header = [
        "ply",
        f"format {'ascii' if text else 'binary_little_endian'} 1.0",
        "comment meters",
        f"element vertex {len(vertices)}",
        *(f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in kinds.items()),
    ]
    parts = [vertices]
    if triangles is not None:
        faces = np.empty(len(triangles), [("count", "u1"), ("vertices", "<i4", 3)])
        faces["count"], faces["vertices"] = 3, triangles
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        parts.append(faces)
    data = b"".join(_lines(part) if text else part.tobytes() for part in parts)
    write_file(path, "\n".join([*header, "end_header", ""]).encode() + data, overwrite=overwrite, make_folders=True)


def _lines(table: npt.NDArray[Any]) -> bytes:
    """A line for each row of a structured array."""
    rows = (np.concatenate([np.ravel(value) for value in row]) for row in table.tolist())
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows).encode()

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""LAS and LAZ files of points (version 1.4 of the ASPRS), by laspy, which the extra ``las`` brings."""

from __future__ import annotations

import importlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.files.output import write_file

__all__ = ["check_las", "write_las"]

_RGB_POINTS, _PLAIN_POINTS = 7, 6  # point formats
_FINEST_M = 1e-6
_LARGEST = 2**31 - 1  # of the stored integers


def check_las(path: Path) -> Any:
    """The module laspy, if it can write this file.

    Raises:
        OutputError: laspy is missing, or lazrs for .laz, with the extra that brings them.
    """
    compressed = path.suffix.lower() == ".laz"
    try:
        laspy = importlib.import_module("laspy")
        if compressed:
            importlib.import_module("lazrs")
    except ImportError as error:
        needed = "laspy and lazrs" if compressed else "laspy"
        raise OutputError(
            f"cannot be written: {path.suffix} files need {needed} ({error})",
            subject=str(path),
            value=path.suffix,
            limit=needed,
            remedy="pip install laspy lazrs, which the extra las brings, or choose .ply or .pcd",
        ) from error
    return laspy


def write_las(
    path: Path,
    points_m: F32 | F64,
    values: Mapping[str, npt.NDArray[Any]] | None = None,
    *,
    rgb: U8 | None = None,
    overwrite: bool = False,
) -> None:
    """Write points; a name that ends in .laz is compressed.

    Args:
        path: the file; missing folders are created.
        points_m: float (N, 3), finite; stored in steps of 1 um, or of more where they are farther than 2 km.
        values: further values by name, (N,): intensity (0..255) takes its place in the format, others are extra
            dimensions of float32.
        rgb: uint8 (N, 3) RGB.
        overwrite: replace a file that is there.

    Raises:
        OutputError: laspy is missing, the file exists and ``overwrite`` is false, or it cannot be written.
    """
    laspy = check_las(path)
    farthest = float(np.abs(points_m).max(initial=0.0))
    step = _FINEST_M
    while farthest / step > _LARGEST:
        step *= 10
    header = laspy.LasHeader(point_format=_PLAIN_POINTS if rgb is None else _RGB_POINTS, version="1.4")
    header.scales, header.offsets = np.full(3, step), np.zeros(3)
    others = {name: value for name, value in (values or {}).items() if name != "intensity"}
    for name in others:
        header.add_extra_dim(laspy.ExtraBytesParams(name, np.float32))
    file = laspy.LasData(header)
    file.return_number = file.number_of_returns = np.ones(len(points_m), np.uint8)
    file.x, file.y, file.z = np.asarray(points_m, np.float64).T
    if values is not None and "intensity" in values:
        file.intensity = np.clip(np.rint(np.asarray(values["intensity"], np.float64) * 257), 0, 65535)
    for name, value in others.items():
        file[name] = np.asarray(value, np.float32)
    if rgb is not None:
        file.red, file.green, file.blue = rgb.T.astype(np.uint16) * np.uint16(257)  # 16 bits, as the format demands
    output = io.BytesIO()
    file.write(output, do_compress=path.suffix.lower() == ".laz")
    write_file(path, output.getvalue(), overwrite=overwrite, make_folders=True)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads an array of disparities or depths from .npz and .npy files: a stated largest size, and no pickled objects."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from stereo_depth_ros.core.camera import MAX_PIXELS
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.text_files import read_bytes
from stereo_depth_ros.core.types import F32

__all__ = ["MAX_ARRAY_BYTES", "read_array", "read_npz"]

MAX_ARRAY_BYTES = 8 * MAX_PIXELS + 4096  # of the first array, with its header, after decompression
_NUMBERS = "fiub"  # kinds of dtype: floating-point, integers, bool


def read_npz(path: Path) -> F32:
    """The first array of the file, float32 (H, W).

    Its size is checked in the directory of the zip file and while it is decompressed.

    Raises:
        BagError: not an .npz file, damaged, too large, or not an array of numbers of two dimensions.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            data = _first_member(archive, path)
    except BagError:
        raise
    except Exception as error:  # those of zipfile and zlib have no common base class
        raise _unreadable(path, "it is damaged, or not an .npz file") from error
    return _array(data, path, "its first array")


def read_array(path: Path) -> F32:
    """The array of an .npy file, float32 (H, W).

    Raises:
        BagError: not an .npy file, damaged, too large, or not an array of numbers of two dimensions.
    """
    return _array(read_bytes(path, BagError, "check the path", MAX_ARRAY_BYTES), path, "it")


def _array(data: bytes, path: Path, what: str) -> F32:
    """The array of the bytes of an .npy file."""
    header = io.BytesIO(data)
    try:
        shape, _, dtype = _read_header(header)
    except Exception as error:  # those of numpy have no common base class
        kind = path.suffix or ".npy"
        raise _unreadable(path, f"it is damaged, or not an {kind} file") from error
    if len(shape) != 2 or dtype.kind not in _NUMBERS or not all(shape):
        size = "x".join(map(str, shape)) or "no"
        raise _unreadable(path, f"{what} has {size} values of type {dtype}, disparities are rows x columns")
    if shape[0] * shape[1] * dtype.itemsize != len(data) - header.tell():
        raise _unreadable(path, f"it has {len(data) - header.tell()} bytes, its header declares {shape[0]}x{shape[1]}")
    with np.errstate(over="ignore"):  # inf is unknown
        return np.array(npy.read_array(io.BytesIO(data), allow_pickle=False), np.float32)


def _first_member(archive: zipfile.ZipFile, path: Path) -> bytes:
    members = archive.infolist()
    if not members:
        raise _unreadable(path, "it holds no array")
    data = b""
    if members[0].file_size <= MAX_ARRAY_BYTES:
        with archive.open(members[0]) as file:
            data = file.read(MAX_ARRAY_BYTES + 1)
    if members[0].file_size > MAX_ARRAY_BYTES or len(data) > MAX_ARRAY_BYTES:
        raise _unreadable(path, f"its first array has more than {MAX_ARRAY_BYTES} bytes")
    return data


def _read_header(file: io.BytesIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = npy.read_magic(file)
    return npy.read_array_header_1_0(file) if version == (1, 0) else npy.read_array_header_2_0(file)


def _unreadable(path: Path, why: str) -> BagError:
    return BagError(f"is not a readable array of disparities, {why}", subject=str(path), remedy="copy it again")

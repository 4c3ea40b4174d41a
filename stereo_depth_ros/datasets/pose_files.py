# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of poses: KITTI odometry, the CSV files of EuRoC (ASL), and the text files of the TUM benchmark.

Geiger, Lenz and Urtasun 2012 (KITTI); Burri et al. 2016 (EuRoC); Sturm et al. 2012 (TUM RGB-D).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import NoReturn

import numpy as np

from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.text_files import read_text
from stereo_depth_ros.core.types import F64

__all__ = ["EUROC", "KITTI", "TUM", "PoseFile", "read_poses"]

KITTI, EUROC, TUM = "KITTI", "EuRoC", "TUM"
_MOST_BYTES = 2**28
_NANOSECONDS = 1e14  # numbers above it are not seconds
_END_NS = 2**63 - 1
_LARGEST = 1e9  # of the numbers of a pose, meters
_NOT_RIGID = 0.02  # largest difference of R^T R from 1, and of the length of a quaternion from 1
_REMEDY = (
    "give poses of KITTI (12 numbers a row, three rows of a matrix), of EuRoC (CSV: nanoseconds, x, y, z, qw, qx, qy, "
    "qz) or of TUM (seconds, x, y, z, qx, qy, qz, qw)"
)


@dataclass(frozen=True, eq=False)
class PoseFile:
    """Poses of a file, each from the frame that is posed to the world.

    Attributes:
        kind: KITTI, EUROC or TUM.
        poses: in the order of the rows.
        stamps_ns: time of each, integer nanoseconds; empty where the rows are those of the frames.
        numbers: number of the frame of each; empty where the file has times, or a row for every frame.
    """

    kind: str
    poses: list[Pose]
    stamps_ns: list[int]
    numbers: list[int]


def read_poses(path: Path) -> PoseFile:
    """Reads a file; its content tells the format.

    Raises:
        BagError: not a file of poses, positions without orientations, or a row that is not a pose.
    """
    rows = [*_rows(read_text(path, BagError, _REMEDY, _MOST_BYTES))]
    if not rows:
        raise BagError("holds no poses", subject=str(path), value=0, remedy=_REMEDY, settings=("poses",))
    line, words, commas = rows[0]
    read = _format(len(words), commas, words[0])
    if read is None:
        _refuse(path, line, words, commas)
    kind, first, is_matrix = read
    poses, keys = [], []
    for line, row, _ in rows:
        if len(row) != len(words):
            raise _wrong(path, line, f"has {len(row)} numbers, line {rows[0][0]} has {len(words)}")
        values = _numbers(path, line, row[first:])
        poses.append(_matrix_pose(values, path, line) if is_matrix else _quaternion_pose(values, kind, path, line))
        if first:
            keys.append(_key(path, line, row[0], is_number=is_matrix))
    if is_matrix:
        return PoseFile(kind, poses, [], keys)
    return PoseFile(kind, poses, keys, [])


def _rows(text: str) -> Iterator[tuple[int, list[str], bool]]:
    """Number of the line, its words, and whether commas are between them; without comments and a line of names."""
    for number, line in enumerate(text.splitlines(), start=1):
        row = line.partition("#")[0].strip()
        words = re.split(r"\s*,\s*", row.rstrip(",")) if "," in row else row.split()
        if not row or (number == 1 and not re.match(r"[-+.\d]", row)):
            continue
        yield number, words, "," in row


def _format(count: int, commas: bool, first: str) -> tuple[str, int, bool] | None:
    """Name, number of columns before the pose, and whether it is a matrix; None where it is not known."""
    if not commas and count in (12, 16):
        return KITTI, 0, True
    if not commas and count in (13, 17):  # with the number of the frame, as of KITTI-360
        return KITTI, 1, True
    if commas and count >= 8 and first.isdigit() and float(first) > _NANOSECONDS:
        return EUROC, 1, False
    return (TUM, 1, False) if not commas and count == 8 else None


def _refuse(path: Path, line: int, words: list[str], commas: bool) -> NoReturn:
    if commas and len(words) == 4:
        raise BagError(
            "holds positions without orientations, as of a laser tracker",
            subject=str(path),
            value=len(words),
            limit=8,
            remedy="give poses, such as state_groundtruth_estimate0/data.csv",
            settings=("poses",),
        )
    raise _wrong(path, line, f"has {len(words)} {'values with commas' if commas else 'values'}, not those of a pose")


def _numbers(path: Path, line: int, words: list[str]) -> F64:
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise _wrong(path, line, "has a word that is not a number") from error
    if not np.isfinite(values).all():
        raise _wrong(path, line, "has a number that is not finite")
    if values.size > 1 and np.abs(values).max() > _LARGEST:
        raise _wrong(path, line, f"has the number {values[np.abs(values).argmax()]:g}, {_LARGEST:g} is the largest")
    return values


def _key(path: Path, line: int, word: str, *, is_number: bool) -> int:
    """The number of a frame, or a time in nanoseconds."""
    value = float(_numbers(path, line, [word])[0])
    if is_number:
        return round(value)
    stamp_ns = Decimal(word) * (1 if value > _NANOSECONDS else 10**9)  # a float has no nanoseconds
    if not 0 <= stamp_ns <= _END_NS:
        raise _wrong(path, line, f"has the time {quoted(word)}, which is outside 0..{_END_NS} ns")
    return round(stamp_ns)


def _matrix_pose(values: F64, path: Path, line: int) -> Pose:
    matrix = values[:12].reshape(3, 4)
    u, _, vt = np.linalg.svd(matrix[:, :3])
    rotation = u @ vt
    off = float(np.abs(matrix[:, :3].T @ matrix[:, :3] - np.identity(3)).max())
    if off > _NOT_RIGID or np.linalg.det(rotation) < 0:
        raise _wrong(path, line, f"has a matrix that is not a rotation: R^T R differs from 1 by {off:.3g}")
    return Pose(np.asarray(rotation, np.float64), matrix[:, 3].copy())


def _quaternion_pose(values: F64, kind: str, path: Path, line: int) -> Pose:
    order = [4, 5, 6, 3] if kind == EUROC else [3, 4, 5, 6]
    quaternion = values[order]
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1) > _NOT_RIGID:
        raise _wrong(path, line, f"has a quaternion of length {length:.4g}, not 1")
    return Pose.from_quaternion(quaternion, values[:3])


def _wrong(path: Path, line: int, problem: str) -> BagError:
    return BagError(f"line {line} {problem}", subject=str(path), value=line, remedy=_REMEDY, settings=("poses",))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads a rig from calibration files: one that holds both cameras, two of one camera each, or a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from stereo_depth_ros.camera_files.assembling import rig_of
from stereo_depth_ros.camera_files.documents import read_documents
from stereo_depth_ros.camera_files.formats import read_document
from stereo_depth_ros.camera_files.stored import Size, StoredFile
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig

__all__ = ["is_rig_folder", "read_rig_files", "rig_file_paths"]

_REMEDY = "give the files of the left and of the right camera, one file with both, or their folder"
# Files of a rig in a folder; the first that are all there are read.
_FOLDERS = (
    ("left.yaml", "right.yaml"),
    ("left.yml", "right.yml"),
    ("camera_left.yaml", "camera_right.yaml"),
    ("intrinsics.yml", "extrinsics.yml"),
    ("intrinsics.yaml", "extrinsics.yaml"),
    ("cam0/sensor.yaml", "cam1/sensor.yaml"),
    ("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml"),
    ("camchain.yaml",),
    ("calibrationdata.tar.gz",),
)
_BESIDE = ("extrinsics.yaml", "extrinsics.yml")  # of cameras without a pose


def read_rig_files(
    paths: Sequence[Path], size: Size | None = None, sizes: tuple[Size, Size] | None = None
) -> StereoRig:
    """The rig of calibration files, of any format in :data:`FORMATS`; its topics are the files.

    Args:
        paths: the files of the left and of the right camera, or of intrinsics and extrinsics; or one file that holds
            both cameras; or one of the left camera beside which there is one of the same name with "right"; or their
            folder.
        size: of the images, px, where it is known: for files that do not state it, and for cameras that publish
            smaller images than were calibrated (OAK).
        sizes: of the left and of the right images where they differ, see :func:`rig_of`.

    Raises:
        CalibrationError: files that are not there, of no known format, or not those of a stereo rig.
    """
    return rig_of([file for _, file in _read(paths)], size, sizes)


def rig_file_paths(paths: Sequence[Path]) -> list[Path]:
    """The files that :func:`read_rig_files` reads, but for those that settings of VINS name.

    Raises:
        CalibrationError: as there.
    """
    return list(dict.fromkeys(path for path, _ in _read(paths)))


def is_rig_folder(path: Path) -> bool:
    """Whether a folder holds the files of a calibration."""
    return path.is_dir() and _of_folder(path) is not None


def _read(paths: Sequence[Path]) -> list[tuple[Path, StoredFile]]:
    """The files in the order left, right, and what they hold; with the file of the pose beside those that lack one."""
    if len(paths) not in (1, 2):
        raise CalibrationError(f"{len(paths)} paths, not 1 or 2", value=len(paths), limit=(1, 2), remedy=_REMEDY)
    if len(paths) == 1 and paths[0].is_dir():
        paths = _of_folder(paths[0]) or _refuse_folder(paths[0])
    files = [(path, file) for path in paths for file in _read_file(path)]
    if len(paths) == 1 and _count(files) == 1:
        files = _with_partner(*files[0])
    if _count(files) == 2 and _lacks_pose(files):
        folder = files[0][0].parent
        beside = next((folder / name for name in _BESIDE if (folder / name).is_file()), None)
        files += [] if beside is None else [(beside, file) for file in _read_file(beside)]
    return files


def _read_file(path: Path) -> list[StoredFile]:
    return [read_document(document) for document in read_documents(path)]


def _count(files: Sequence[tuple[Path, StoredFile]]) -> int:
    """The number of cameras."""
    return sum(2 if file.build is not None else len(file.cameras) for _, file in files)


def _lacks_pose(files: Sequence[tuple[Path, StoredFile]]) -> bool:
    """Whether neither a pose nor the rectification of the cameras is known."""
    if any(file.pose is not None or file.build is not None for _, file in files):
        return False
    return any(camera.P is None and camera.body is None for _, file in files for camera in file.cameras)


def _of_folder(folder: Path) -> list[Path] | None:
    for names in _FOLDERS:
        if all((folder / name).is_file() for name in names):
            return [folder / name for name in names]
    return None


def _refuse_folder(folder: Path) -> NoReturn:
    raise CalibrationError(
        "is a folder without the files of a calibration",
        subject=str(folder),
        limit=tuple(" and ".join(names) for names in _FOLDERS),
        remedy=_REMEDY,
    )


def _with_partner(path: Path, file: StoredFile) -> list[tuple[Path, StoredFile]]:
    """The files of the left and of the right camera, from one of them."""
    side, other = ("left", "right") if "left" in path.name else ("right", "left")
    before, _, after = path.name.rpartition(side)
    partner = path.with_name(f"{before}{other}{after}") if side in path.name else path
    if partner == path or not partner.exists():
        reason = (
            f"there is no {partner.name} in its folder" if partner != path else "its name has neither left nor right"
        )
        raise CalibrationError(
            f"{file.format}, one camera, and {reason}", subject=str(path), remedy="give LEFT.yaml and RIGHT.yaml"
        )
    files = [(path, file), *((partner, each) for each in _read_file(partner))]
    return files if side == "left" else files[::-1]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table of the formats of calibration files: name, how a file of it is recognized, and its reader."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from stereo_depth_ros.camera_files import camodocal, euroc, kalibr, kitti, middlebury, oakd, opencv, orbslam, ros
from stereo_depth_ros.camera_files.documents import Document, read_documents
from stereo_depth_ros.camera_files.stored import StoredFile
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.quoted import quoted

__all__ = ["FORMATS", "Format", "read_document"]


class Format(NamedTuple):
    """One format.

    Attributes:
        name: of the format.
        recognizes: whether a document has it.
        read: what the document holds; raises CalibrationError.
    """

    name: str
    recognizes: Callable[[Document], bool]
    read: Callable[[Document], StoredFile]


def _read_vins(document: Document) -> StoredFile:
    def read_beside(name: str) -> StoredFile:
        if document.folder is None:
            raise CalibrationError(
                f"names {quoted(name)}, which is not in the archive", remedy="give the files unpacked"
            )
        documents = read_documents(document.folder / name)
        if len(documents) != 1 or not camodocal.is_camera(documents[0]):
            raise CalibrationError(
                f"{quoted(name)} is not a {camodocal.CAMODOCAL}", remedy="give the file of the camera"
            )
        return camodocal.read_camera(documents[0])

    return camodocal.read_vins(document, read_beside)


# The first that recognizes a document reads it: the matrices of OpenCV have many names, so they come last.
FORMATS: tuple[Format, ...] = (
    Format(ros.YAML, ros.is_yaml, ros.read_yaml),
    Format(ros.INI, ros.is_ini, ros.read_ini),
    Format(kalibr.KALIBR, kalibr.is_camchain, kalibr.read_camchain),
    Format(camodocal.CAMODOCAL, camodocal.is_camera, camodocal.read_camera),
    Format(camodocal.EXTRINSICS, camodocal.is_extrinsics, camodocal.read_extrinsics),
    Format(camodocal.VINS, camodocal.is_vins, _read_vins),
    Format(oakd.DEPTHAI, oakd.is_depthai, oakd.read_depthai),
    Format(oakd.STEREODEMO, oakd.is_stereodemo, oakd.read_stereodemo),
    Format(euroc.EUROC, euroc.is_sensor, euroc.read_sensor),
    Format(orbslam.ORB_SLAM, orbslam.is_settings, orbslam.read_settings),
    Format(middlebury.MIDDLEBURY, middlebury.is_middlebury, middlebury.read_middlebury),
    Format(kitti.KITTI, kitti.is_kitti, kitti.read_kitti),
    Format(opencv.OPENCV, opencv.is_opencv, opencv.read_opencv),
)


def read_document(document: Document) -> StoredFile:
    """What a document holds.

    Raises:
        CalibrationError: it has none of the formats, or its format cannot be used.
    """
    for form in FORMATS:
        if form.recognizes(document):
            try:
                return form.read(document)
            except CalibrationError as error:
                raise error if error.subject.startswith(document.source) else error.about(document.source) from error
    keys = ", ".join(quoted(key) for key in list(document.values)[:5])
    raise CalibrationError(
        f"is not a calibration of a known format, it has {keys or 'other text'}",
        subject=document.source,
        limit=tuple(form.name for form in FORMATS),
        remedy="give a file of camera_calibration, Kalibr, OpenCV or another format in docs/calibration.md",
    )

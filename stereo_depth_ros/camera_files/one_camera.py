# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reads one camera from a calibration file of any known format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from stereo_depth_ros.camera_files.assembling import no_size
from stereo_depth_ros.camera_files.documents import read_documents
from stereo_depth_ros.camera_files.formats import read_document
from stereo_depth_ros.camera_files.stored import Size
from stereo_depth_ros.core.camera import CameraModel, check_intrinsics
from stereo_depth_ros.core.errors import CalibrationError

__all__ = ["read_camera"]


def read_camera(path: Path, size: Size | None = None) -> CameraModel:
    """The camera of a calibration file; where it has no rectification, R is the identity and P is K.

    Args:
        path: a file of a format in :data:`FORMATS` with one camera.
        size: of the images, px, for files that do not state it.

    Raises:
        CalibrationError: a file that is not there, of no known format, of several cameras, or without a size.
    """
    found = [(file, camera) for file in map(read_document, read_documents(path)) for camera in file.cameras]
    if len(found) != 1:
        raise CalibrationError(
            f"holds {len(found)} cameras, one is needed",
            subject=str(path),
            value=len(found),
            limit=1,
            remedy="give the file of one camera, such as left.yaml",
            settings=("camera",),
        )
    _, camera = found[0]
    size = camera.size or size
    if size is None:
        raise no_size(str(path))
    R = np.identity(3) if camera.R is None else camera.R
    P = np.column_stack((camera.K, np.zeros(3))) if camera.P is None else camera.P
    model = CameraModel(size[0], size[1], camera.distortion_model, camera.K, camera.D, R, P).described()
    check_intrinsics(model, str(path))
    return replace(model, frame_id="")

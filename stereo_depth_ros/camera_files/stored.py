# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a calibration file holds: cameras and their poses, as they are stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

__all__ = ["Pose", "Rectification", "Size", "StoredCamera", "StoredFile"]

Size: TypeAlias = tuple[int, int]  # width, height, px
Rectification: TypeAlias = tuple[F64, F64]
Pose: TypeAlias = tuple[F64, F64]  # R (3, 3) and T (3,) in meters, with X_second = R X_first + T


@dataclass(frozen=True)
class StoredCamera:
    """One camera of a file.

    Attributes:
        name: in the file; empty where the file is that of one camera.
        K: float64 (3, 3), px.
        distortion_model: a name of ROS.
        D: float64 (n,), its coefficients.
        size: of the images; None where the file does not state it.
        R, P: float64 (3, 3) and (3, 4), the rectification; None where the file has none.
        body: float64 (4, 4), from the camera to a frame that both cameras share, meters; None where the file has none.
    """

    name: str
    K: F64
    distortion_model: str
    D: F64
    size: Size | None
    R: F64 | None = None
    P: F64 | None = None
    body: F64 | None = None


@dataclass(frozen=True)
class StoredFile:
    """One file.

    Attributes:
        format: its name, such as "Kalibr camchain".
        source: its path.
        cameras: none, one, or the first and the second one.
        pose: of the second camera.
        rectification: R (3, 3) and P (3, 4) of the first and of the second camera, float64.
        numbered: the names say nothing about the sides, so that the pose decides which camera is the left one.
        scales: the images may be smaller than those of the calibration, by the camera itself.
        build: makes the rig where the file holds one that is rectified; the argument is the size of the images, None
            where it is not known.
    """

    format: str
    source: str
    cameras: tuple[StoredCamera, ...] = ()
    pose: Pose | None = None
    rectification: tuple[Rectification, Rectification] | None = None
    numbered: bool = False
    scales: bool = False
    build: Callable[[Size | None], StereoRig] | None = None

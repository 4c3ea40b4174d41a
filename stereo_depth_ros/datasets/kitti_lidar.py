# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The laser scanner of KITTI: its sweeps beside the images, their stamps, and its pose.

Geiger et al., "Vision meets robotics: the KITTI dataset", IJRR 2013.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stereo_depth_ros.camera_files.extrinsics import kitti_extrinsics
from stereo_depth_ros.camera_files.kitti import parse_calibration, reference_from_camera
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.text_files import read_bytes, read_text
from stereo_depth_ros.core.transforms import StaticTransform
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.datasets.dataset import Sweep
from stereo_depth_ros.datasets.kitti_stamps import read_stamps

__all__ = ["KittiLidar", "find_lidar"]

FRAME_ID = "velodyne"
_FOLDERS = ("velodyne", "velodyne_points/data")  # of odometry and objects, of a drive
_TIMES = Path("velodyne_points")  # folder of timestamps.txt
_POSE = "calib_velo_to_cam.txt"  # of a drive, in its folder or in that of the day
_POINT_BYTES = 16  # float32 x forward, y left, z up, reflectance
_MOST_BYTES = 2**27  # of a sweep; those of KITTI have 2 MB
_COPY = "copy it again"


class KittiLidar:
    """The sweeps of a sequence.

    Attributes:
        transform: pose of the scanner in the frame of the left camera.
        files: files of the sweeps that are there, the times and the calibration.
        missing: number of pairs without a sweep.
    """

    def __init__(
        self, folder: Path, transform: StaticTransform, stamps_ns: Mapping[str, int], files: list[Path]
    ) -> None:
        self._folder, self._stamps_ns = folder, stamps_ns
        self.transform = transform
        self.files = [*files, *(path for name in stamps_ns if (path := self._file(name)).exists())]
        self.missing = sum(not self._file(name).exists() for name in stamps_ns)

    def sweep(self, image: str) -> Sweep | None:
        """The sweep of a pair, by the name of its images; None without one.

        Raises:
            BagError: a file that is not one of points of four float32.
        """
        path = self._file(image)
        if not path.exists():
            return None
        content = read_bytes(path, BagError, _COPY, _MOST_BYTES)
        if len(content) % _POINT_BYTES:
            raise BagError(
                f"has {len(content)} bytes, points of KITTI have {_POINT_BYTES}",
                subject=str(path),
                value=len(content),
                limit=_POINT_BYTES,
                remedy=_COPY,
            )
        return Sweep(
            np.frombuffer(content, "<f4").astype(np.float32, copy=False).reshape(-1, 4),
            self._stamps_ns[image],
            FRAME_ID,
        )

    def _file(self, image: str) -> Path:
        return self._folder / f"{Path(image).stem}.bin"


def find_lidar(
    folder: Path,
    calibration: Path,
    left_camera: int,
    rig: StereoRig,
    numbers: dict[str, int],
    stamps_ns: Mapping[str, int],
) -> KittiLidar | None:
    """The sweeps of a sequence; None where it has none.

    Args:
        folder: the sequence.
        calibration: its calib.txt or calib_cam_to_cam.txt.
        left_camera: number of the left camera.
        rig: of the images.
        numbers: frame numbers of all left images by name.
        stamps_ns: of the pairs by name.

    Raises:
        BagError: a file that cannot be read, or times that do not fit.
        CalibrationError: no pose of the scanner, or one that is not.
    """
    sweeps = next((folder / name for name in _FOLDERS if (folder / name).is_dir()), None)
    if sweeps is None:
        return None
    of_drive = next((path for path in (folder / _POSE, folder.parent / _POSE) if path.exists()), calibration)
    cameras = _values(calibration)
    try:
        extrinsics = kitti_extrinsics(_values(of_drive), cameras)
    except (BagError, CalibrationError) as error:
        raise error.about(of_drive) from error
    if not extrinsics.rectified:
        raise CalibrationError(
            "has no R_rect_00, the rotation to the rectified camera",
            subject=str(calibration),
            limit="R_rect_00",
            remedy="copy calib_cam_to_cam.txt of the same day",
        )
    # to the rectified camera 0, from there to the rectified left one, which may be another, and to its images
    shift = reference_from_camera(cameras, left_camera).inverse()
    pose = Pose(rig.left.R, np.zeros(3)).inverse() @ shift @ extrinsics.parent_from_child
    times = folder / _TIMES / "timestamps.txt"
    of_sweeps = read_stamps(folder, _TIMES, numbers, list(stamps_ns)) if times.exists() else stamps_ns
    return KittiLidar(sweeps, StaticTransform(rig.frame_id, FRAME_ID, pose), of_sweeps, [of_drive, times])


def _values(path: Path) -> dict[str, F64]:
    return parse_calibration(read_text(path, BagError, _COPY))

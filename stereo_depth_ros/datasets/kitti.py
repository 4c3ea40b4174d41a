# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""KITTI: odometry sequences, stereo benchmarks of 2012 and 2015, raw drives with or without rectification.

Geiger et al., "Vision meets robotics: the KITTI dataset", IJRR 2013.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stereo_depth_ros.camera_files.kitti import parse_calibration, reference_from_camera, rig_from_calibration
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.text_files import read_bytes, read_text
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.datasets.dataset import DatasetFrame
from stereo_depth_ros.datasets.image_files import (
    checked_truth,
    list_images,
    read_disparity_image,
    read_frame,
    read_image,
)
from stereo_depth_ros.datasets.kitti_lidar import KittiLidar, find_lidar
from stereo_depth_ros.datasets.kitti_stamps import frame_numbers, read_stamps

__all__ = ["KITTI_FOLDERS", "KittiDataset", "read_calibration", "read_truth"]

# folders of left and right images, and the numbers of the two cameras
_LAYOUTS = (
    ("image_l", "image_r", 0, 1),
    ("image_0", "image_1", 0, 1),
    ("image_2", "image_3", 2, 3),
    ("image_00/data", "image_01/data", 0, 1),
    ("image_02/data", "image_03/data", 2, 3),
)
KITTI_FOLDERS = tuple(layout[0] for layout in _LAYOUTS)
_COPY = "copy it again"
_TRUTH_FOLDERS = ("disp_occ_0", "disp_occ")


class KittiDataset:
    """A sequence, or the training pairs of a stereo benchmark.

    The stereo benchmarks have one calibration file per pair; pairs with the calibration of the first one are read,
    ``skipped`` counts the others. Stamps follow the frame numbers in the names, so that excerpts keep theirs.

    Sweeps of the laser scanner are those in ``velodyne`` or ``velodyne_points/data``. Its pose in the frame of the left
    camera is in ``transforms``, what is left out of the sweeps in ``warnings``.

    Args:
        folder: the folder that holds ``image_0`` and ``image_1`` (or ``image_2``/``image_3``, ``image_l``/``image_r``,
            ``image_00/data``/``image_01/data``).

    Attributes:
        numbers: frame number of each pair.
        image_numbers: frame number of each left image, with and without a partner, in order.
        reference_from_left: pose of the rectified left camera in the frame of camera 0.

    Raises:
        BagError: unknown layout, no calibration, a name without frame number, or a file that cannot be read.
        CalibrationError: a calibration that is not that of a rectified pair.
    """

    has_stamps = True

    def __init__(self, folder: Path) -> None:
        left, right, *cameras = next((x for x in _LAYOUTS if (folder / x[0]).is_dir()), _LAYOUTS[0])
        self.folder = folder
        numbers = frame_numbers(list_images(folder / left))
        names = [name for name in numbers if (folder / right / name).exists()]
        if not names:
            raise BagError(
                "is not a KITTI folder, it has no pairs in image_0 and image_1 or the like",
                subject=str(folder),
                remedy=f"name the folder that holds {' or '.join(f'{x[0]} and {x[1]}' for x in _LAYOUTS)}",
            )
        calibrations = {name: _find_calibration(folder, name) for name in names}
        first = read_bytes(calibrations[names[0]], BagError, _COPY)
        kept = [name for name in names if read_bytes(calibrations[name], BagError, _COPY) == first]
        self.skipped = len(names) - len(kept)
        self._pairs = [(folder / left / name, folder / right / name) for name in kept]
        self._stamps = read_stamps(folder, Path(left).parent, numbers, names)
        self.numbers, self.image_numbers = [numbers[name] for name in kept], [*numbers.values()]
        truths = [folder / truth / name for truth in _TRUTH_FOLDERS for name in kept]
        times = [folder / "times.txt", folder / Path(left).parent / "timestamps.txt"]
        self.files = [*calibrations.values(), *times, *(path for pair in self._pairs for path in pair), *truths]
        height, width = read_image(self._pairs[0][0]).shape[:2]
        path = calibrations[names[0]]
        calibration = read_calibration(path)
        try:
            self.rig = rig_from_calibration(calibration, (cameras[0], cameras[1]), (width, height))
            self.reference_from_left = reference_from_camera(calibration, cameras[0])
        except (BagError, CalibrationError) as error:
            raise error.about(path) from error
        self.warnings: list[str] = []
        self._lidar = self._find_lidar(path, cameras[0], numbers, {name: self._stamps[name] for name in kept})
        self.transforms = [] if self._lidar is None else [self._lidar.transform]
        self.files += [] if self._lidar is None else self._lidar.files

    def _find_lidar(
        self, calibration: Path, left_camera: int, numbers: dict[str, int], stamps_ns: dict[str, int]
    ) -> KittiLidar | None:
        try:
            lidar = find_lidar(self.folder, calibration, left_camera, self.rig, numbers, stamps_ns)
        except CalibrationError as error:
            self.warnings.append(f"the sweeps of the laser scanner are left out: {error}")
            return None
        if lidar is not None and lidar.missing:
            self.warnings.append(f"{lidar.missing} of {len(self)} pairs have no sweep of the laser scanner")
        return lidar

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[DatasetFrame]:
        for left, right in self._pairs:
            stamp_ns = self._stamps[left.name]
            yield DatasetFrame(
                read_frame(left, self.rig.left, stamp_ns),
                read_frame(right, self.rig.right, stamp_ns),
                self._truth(left.name),
                None if self._lidar is None else self._lidar.sweep(left.name),
            )

    def _truth(self, name: str) -> F32 | None:
        path = next((self.folder / x / name for x in _TRUTH_FOLDERS if (self.folder / x / name).exists()), None)
        return None if path is None else checked_truth(read_truth(path), (self.rig.width, self.rig.height), path)


def read_calibration(path: Path) -> dict[str, F64]:
    """The values of a calibration file by name, as of :func:`parse_calibration`.

    Raises:
        BagError: not a readable text, or a row with text that is not a number.
    """
    text = read_text(path, BagError, _COPY)
    try:
        return parse_calibration(text)
    except BagError as error:
        raise error.about(path) from error


def _find_calibration(folder: Path, image: str) -> Path:
    """The calibration file of the sequence, of the pair (the name without frame number) or of the day of the drive."""
    pair = image.partition("_")[0].partition(".")[0] + ".txt"
    places = [
        folder / "calib.txt",
        folder / "calib_cam_to_cam.txt",
        folder / "calib_cam_to_cam" / pair,
        folder / "calib" / pair,
        folder.parent / "calib_cam_to_cam.txt",
    ]
    for place in places:
        if place.exists():
            return place
    raise BagError("has no calibration", subject=str(folder), remedy="add calib.txt or calib_cam_to_cam.txt")


def read_truth(path: Path) -> F32:
    """True disparities of the stereo benchmarks, float32 (H, W), pixels, NaN where unknown.

    The files are 16-bit images of 256 levels per pixel of disparity; 0 is unknown.

    Raises:
        BagError: not a readable 16-bit image.
    """
    image = read_disparity_image(path)
    if image.dtype != np.uint16:
        raise BagError(
            f"is {image.dtype}, the disparities of KITTI are uint16",
            subject=str(path),
            value=str(image.dtype),
            limit="uint16",
            remedy="copy it again",
        )
    return np.where(image > 0, image.astype(np.float32) / 256, np.float32(np.nan))

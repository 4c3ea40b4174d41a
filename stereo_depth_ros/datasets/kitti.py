# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""KITTI: odometry sequences, stereo benchmarks of 2012 and 2015, raw drives with or without rectification.

Geiger et al., "Vision meets robotics: the KITTI dataset", IJRR 2013.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.rig import StereoRig
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
from stereo_depth_ros.datasets.kitti_stamps import frame_numbers, read_stamps

__all__ = ["KittiDataset", "read_calibration", "read_truth", "rig_from_calibration"]

# folders of left and right images, and the numbers of the two cameras
_LAYOUTS = (
    ("image_l", "image_r", 0, 1),
    ("image_0", "image_1", 0, 1),
    ("image_2", "image_3", 2, 3),
    ("image_00/data", "image_01/data", 0, 1),
    ("image_02/data", "image_03/data", 2, 3),
)
_COPY = "copy it again"
_TRUTH_FOLDERS = ("disp_occ_0", "disp_occ")


class KittiDataset:
    """A sequence, or the training pairs of a stereo benchmark.

    The stereo benchmarks have one calibration file per pair; pairs with the calibration of the first one are read,
    ``skipped`` counts the others. Stamps follow the frame numbers in the names, so that excerpts keep theirs.

    Args:
        folder: the folder that holds ``image_0`` and ``image_1`` (or ``image_2``/``image_3``, ``image_l``/``image_r``,
            ``image_00/data``/``image_01/data``).

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
        truths = [folder / truth / name for truth in _TRUTH_FOLDERS for name in kept]
        times = [folder / "times.txt", folder / Path(left).parent / "timestamps.txt"]
        self.files = [*calibrations.values(), *times, *(path for pair in self._pairs for path in pair), *truths]
        height, width = read_image(self._pairs[0][0]).shape[:2]
        path = calibrations[names[0]]
        try:
            self.rig = rig_from_calibration(read_calibration(path), (cameras[0], cameras[1]), (width, height))
        except CalibrationError as error:
            raise error.about(path) from error

    def __len__(self) -> int:
        return len(self._pairs)

    def __iter__(self) -> Iterator[DatasetFrame]:
        for left, right in self._pairs:
            stamp_ns = self._stamps[left.name]
            yield DatasetFrame(
                read_frame(left, self.rig.left, stamp_ns),
                read_frame(right, self.rig.right, stamp_ns),
                self._truth(left.name),
            )

    def _truth(self, name: str) -> F32 | None:
        path = next((self.folder / x / name for x in _TRUTH_FOLDERS if (self.folder / x / name).exists()), None)
        return None if path is None else checked_truth(read_truth(path), (self.rig.width, self.rig.height), path)


def read_calibration(path: Path) -> dict[str, F64]:
    """The values of a calibration file by name, float64 (N,); rows without names are P0, P1, ...

    Raises:
        BagError: not a readable text, or a row with text that is not a number.
    """
    values: dict[str, F64] = {}
    for row in read_text(path, BagError, _COPY).splitlines():
        name, colon, numbers = row.rpartition(":")
        if not row.strip() or name == "calib_time" or row.startswith("calib_time"):
            continue
        try:
            values[name.strip() if colon else f"P{len(values)}"] = np.array(numbers.split(), np.float64)
        except ValueError as error:
            raise BagError(
                f"is not a KITTI calibration, row {quoted(row)} has a word that is not a number",
                subject=str(path),
                value=row,
                remedy=_COPY,
            ) from error
    return values


def rig_from_calibration(values: dict[str, F64], cameras: tuple[int, int], size: tuple[int, int]) -> StereoRig:
    """The rig of two cameras.

    Images of size S_rect, and all of odometry, are rectified; images of size S are raw and have K, D, R_rect. The
    vertical offset of some millimeters in P of the color cameras is ignored: their rows are aligned.

    Args:
        values: result of :func:`read_calibration`.
        cameras: numbers of the left and the right camera.
        size: (width, height) of the images, pixels.

    Raises:
        BagError: the calibration lacks these cameras, or a matrix is incomplete.
        CalibrationError: the calibration is not that of a rectified pair.
    """
    left, right = cameras
    try:
        P_left, P_right = (_projection(values, camera) for camera in cameras)
    except KeyError as error:
        raise _lacks(values, error) from error
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # refused by the checks of a rig
        baseline_m = float((P_left[0, 3] - P_right[0, 3]) / P_left[0, 0])
    rig = StereoRig.from_rectified(
        P_left[0, 0], P_left[1, 1], P_left[0, 2], P_right[0, 2], P_left[1, 2], baseline_m, size
    )
    raw_size = values.get(f"S_{left:02d}")
    if raw_size is None or tuple(raw_size) != size:
        return rig
    try:
        return StereoRig(_raw_camera(values, left, rig.left), _raw_camera(values, right, rig.right))
    except KeyError as error:
        raise _lacks(values, error) from error


def _lacks(values: dict[str, F64], error: KeyError) -> BagError:
    names = quoted(", ".join(values))
    return BagError(
        f"the KITTI calibration has no {error.args[0]}, it has {names}",
        value=list(values),
        limit=error.args[0],
        remedy="copy the calibration of these cameras",
    )


def _projection(values: dict[str, F64], camera: int) -> F64:
    name = f"P{camera}" if f"P{camera}" in values else f"P_rect_{camera:02d}"
    return _matrix(values, name, (3, 4))


def _matrix(values: dict[str, F64], name: str, shape: tuple[int, int]) -> F64:
    """The values of one row as a matrix; KeyError if the row is missing."""
    found = values[name]
    if found.size != shape[0] * shape[1]:
        raise BagError(
            f"{name} of the KITTI calibration has {found.size} numbers, not {shape[0] * shape[1]}",
            value=found.size,
            limit=shape[0] * shape[1],
            remedy="copy the calibration again",
        )
    return found.reshape(shape)


def _raw_camera(values: dict[str, F64], camera: int, rectified: CameraModel) -> CameraModel:
    K, R = (_matrix(values, f"{name}_{camera:02d}", (3, 3)) for name in ("K", "R_rect"))
    return CameraModel(
        rectified.width,
        rectified.height,
        "plumb_bob",
        K,
        values[f"D_{camera:02d}"],
        R,
        rectified.P,
        rectified.frame_id,
    )


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

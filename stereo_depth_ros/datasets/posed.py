# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A dataset of any kind with what is known of the poses of its cameras: their file, their frames, frame numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stereo_depth_ros.core.errors import BagError, ConfigError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.datasets.dataset import StereoDataset
from stereo_depth_ros.datasets.euroc import EurocDataset, body_from_sensor
from stereo_depth_ros.datasets.images import ImagesDataset
from stereo_depth_ros.datasets.kitti import KITTI_FOLDERS, KittiDataset

__all__ = ["PosedDataset", "open_posed", "sensor_in_body"]

_EUROC_POSES = ("state_groundtruth_estimate0", "vicon0")


@dataclass(frozen=True, eq=False)
class PosedDataset:
    """A dataset, and the poses beside it.

    Attributes:
        dataset: the pairs.
        poses: file of poses of the dataset itself; None where it has none.
        numbers: frame number of each pair, for files with a row for each frame.
        image_numbers: frame number of each left image, with and without a partner, in order.
        body_from_left: pose of the raw left camera in the body of the sensors; None where there is none.
        reference_from_left: pose of the rectified left camera in the frame of camera 0 of KITTI; None elsewhere.
    """

    dataset: StereoDataset
    poses: Path | None
    numbers: list[int]
    image_numbers: list[int]
    body_from_left: Pose | None = None
    reference_from_left: Pose | None = None


def open_posed(folder: Path, camera_files: Sequence[Path] = (), *, side_by_side: bool = False) -> PosedDataset:
    """Opens KITTI (odometry, raw), EuRoC in the ASL layout, or a folder of images with calibration files.

    Args:
        folder: the folder of the sequence.
        camera_files: calibration files of a folder of images.
        side_by_side: each file of a folder of images holds both.

    Raises:
        BagError, CalibrationError: as of :class:`KittiDataset`, :class:`EurocDataset` and :class:`ImagesDataset`.
        ConfigError: calibration files, or images side by side, of a dataset that has its own.
    """
    if not folder.is_dir():
        raise BagError(
            "is neither a bag nor a folder",
            subject=str(folder),
            remedy="give a bag, a sequence of KITTI or EuRoC, or a folder of images",
        )
    is_euroc = (folder / "mav0").is_dir() or (folder / "cam0" / "data.csv").exists()
    is_kitti = any((folder / name).is_dir() for name in KITTI_FOLDERS)
    if (is_euroc or is_kitti) and (camera_files or side_by_side):
        given = "camera_info" if camera_files else "side_by_side"
        raise ConfigError(
            f"{given} has no effect: the sequence has cameras and files of its own",
            subject=str(folder),
            value=given,
            remedy="leave it out",
            settings=(given,),
        )
    if is_euroc:
        return _of_euroc(EurocDataset(folder))
    if is_kitti:
        return _of_kitti(KittiDataset(folder))
    images = ImagesDataset(folder, camera_files, side_by_side=side_by_side)
    numbers = [*range(len(images))]
    return PosedDataset(images, None, numbers, numbers)


def sensor_in_body(poses: Path) -> Pose:
    """Pose in the body of the sensor whose data.csv this is, by the sensor.yaml beside it; the body itself without one.

    Raises:
        BagError: a sensor.yaml without it.
    """
    path = poses.parent / "sensor.yaml"
    return body_from_sensor(path) if path.is_file() else Pose.identity()


def _of_euroc(dataset: EurocDataset) -> PosedDataset:
    poses = next((path for name in _EUROC_POSES if (path := dataset.root / name / "data.csv").is_file()), None)
    numbers = [*range(len(dataset))]
    return PosedDataset(dataset, poses, numbers, numbers, dataset.body_from_left())


def _of_kitti(dataset: KittiDataset) -> PosedDataset:
    folder = dataset.folder.resolve()
    places = (folder / "poses.txt", folder.parent.parent / "poses" / f"{folder.name}.txt")
    poses = next((path for path in places if path.is_file()), None)
    return PosedDataset(
        dataset, poses, dataset.numbers, dataset.image_numbers, reference_from_left=dataset.reference_from_left
    )

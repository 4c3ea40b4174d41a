# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes a dataset as a bag: images, camera infos, true disparities, and sweeps of a laser scanner with its pose."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.transforms import write_static_transforms
from stereo_depth_ros.bags.writer import BagWriter, check_bag_output
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, Frame
from stereo_depth_ros.datasets.dataset import DatasetFrame, StereoDataset, Sweep
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.disparity import disparity_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.point_cloud import valued_cloud_message

__all__ = ["convert_dataset"]

_MIN_RATE_HZ, _MAX_RATE_HZ = 1e-3, 1e6  # stamps fit into a ROS time, and differ
_FIRST_STAMP_NS = 10**9  # a ROS time of 0 means that no time is set
SWEEPS_TOPIC = "/velodyne_points"
_TRUTH_STEP_PX = 1 / 256  # the smallest step in which one of the datasets stores its truth


def convert_dataset(
    dataset: StereoDataset,
    out: Path,
    *,
    rate_hz: float = 10.0,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Writes ``image_raw`` and ``camera_info`` in ``/left`` and ``/right``, and ``/truth/disparity`` where it is known.

    Sweeps of a laser scanner are written as ``/velodyne_points``, and ``transforms`` of the dataset as ``/tf_static``.

    Args:
        dataset: the dataset to write.
        out: the bag to create, ``.mcap``.
        rate_hz: pairs per second where the dataset has no times.
        overwrite: replace an existing bag.
        progress: called after each pair with the pairs written and all pairs.

    Returns:
        The number of pairs written.

    Raises:
        ConfigError: the rate is outside 0.001..1e6 Hz.
        BagError: the dataset cannot be read.
        OutputError: the bag exists and ``overwrite`` is false, or it is read, or it cannot be written.
    """
    if not _MIN_RATE_HZ <= rate_hz <= _MAX_RATE_HZ:
        raise ConfigError(
            f"rate_hz = {rate_hz} is outside {_MIN_RATE_HZ:g}..{_MAX_RATE_HZ:g}",
            value=rate_hz,
            limit=(_MIN_RATE_HZ, _MAX_RATE_HZ),
            remedy="set pairs per second, for example 10",
            settings=("rate_hz",),
        )
    check_bag_output(out, dataset.files, overwrite=overwrite)
    count, transforms = 0, getattr(dataset, "transforms", [])
    with BagWriter(out, overwrite=overwrite) as bag:
        pairs = _PairWriter(bag, dataset.rig)
        for count, frame in enumerate(dataset, start=1):
            counted_ns = _FIRST_STAMP_NS + round((count - 1) * 1e9 / rate_hz)
            stamped = frame if dataset.has_stamps else _stamped(frame, counted_ns)
            if count == 1 and transforms:
                write_static_transforms(bag, transforms, stamped.left.stamp_ns)
            pairs.write(stamped)
            if progress is not None:
                progress(count, len(dataset))
    return count


class _PairWriter:
    """Writes the messages of one pair."""

    def __init__(self, bag: BagWriter, rig: StereoRig) -> None:
        self._bag = bag
        self._rig = rig
        self._types = RosbagsTypes()

    def write(self, frame: DatasetFrame) -> None:
        for side, image, camera in (("left", frame.left, self._rig.left), ("right", frame.right, self._rig.right)):
            stamp_ns = image.stamp_ns
            info = camera_info_message(self._types, camera, stamp_ns)
            message = image_message(self._types, image.pixels, image.encoding, stamp_ns, image.frame_id)
            self._bag.write(f"/{side}/camera_info", info, stamp_ns)
            self._bag.write(f"/{side}/image_raw", message, stamp_ns)
        if frame.truth_disparity_px is not None:
            self._write_truth(frame.truth_disparity_px, frame.left)
        if frame.sweep is not None:
            self._write_sweep(frame.sweep)

    def _write_sweep(self, sweep: Sweep) -> None:
        points, intensity = sweep.points[:, :3].astype(np.float64), sweep.points[:, 3]
        cloud = valued_cloud_message(
            self._types, points, {"intensity": intensity}, stamp_ns=sweep.stamp_ns, frame_id=sweep.frame_id
        )
        self._bag.write(SWEEPS_TOPIC, cloud, sweep.stamp_ns)

    def _write_truth(self, truth_px: F32, left: Frame) -> None:
        known = truth_px[np.isfinite(truth_px)]
        message = disparity_message(
            self._types,
            truth_px,
            self._rig,
            min_disparity=math.floor(known.min()) if known.size else 0,
            max_disparity=math.ceil(known.max()) if known.size else 0,
            step_px=_TRUTH_STEP_PX,
            stamp_ns=left.stamp_ns,
            frame_id=left.frame_id,
        )
        self._bag.write("/truth/disparity", message, left.stamp_ns)


def _stamped(frame: DatasetFrame, stamp_ns: int) -> DatasetFrame:
    left, right = (replace(image, stamp_ns=stamp_ns) for image in (frame.left, frame.right))
    return replace(frame, left=left, right=right)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sweeps of a range sensor of a bag in the left rectified image of its pairs: matched by stamp, moved and projected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.sweeps import Sweeps
from stereo_depth_ros.bags.transforms import read_transforms
from stereo_depth_ros.camera_files.extrinsics import read_extrinsics
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import TransformError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.ranging.placement import Placement
from stereo_depth_ros.ranging.projection import SparseDisparity, project
from stereo_depth_ros.ranging.sensor_points import DEFAULT_SIGMA_M, SensorPoints

__all__ = ["ProjectedSweep", "ProjectedSweeps", "SensorTopic"]


@dataclass(frozen=True)
class SensorTopic:
    """A range sensor of a bag.

    Attributes:
        topic: PointCloud2, LaserScan or depth Image.
        extrinsics: file with its pose; None takes that of /tf_static and /tf.
    """

    topic: str
    extrinsics: Path | None = None


@dataclass(frozen=True, eq=False)
class ProjectedSweep:
    """A sweep at the time of a pair.

    Attributes:
        in_camera: float32 (N, 3), its points in the left rectified camera, meters.
        sigma_m: standard deviation of the ranges, meters.
        seen: what the left camera sees of them.
    """

    in_camera: F32
    sigma_m: float
    seen: SparseDisparity

    @property
    def prior(self) -> DisparityPrior:
        """What is seen as a prior of a matcher."""
        return DisparityPrior(self.seen.disparity_px, self.seen.sigma_px)


class ProjectedSweeps:
    """Points of a range sensor of a bag in the left rectified image of its pairs.

    Of each pair the sweep with the nearest stamp is taken. Where /tf or odometry tells how the cameras move, points are
    moved to the time of the pair; elsewhere pairs are left out whose sweep is more than half a period away.

    Args:
        reader: the open bag.
        sensor: its topic, and where its pose is.
        rectified_info: topic of the camera infos of left images that are rectified already; None for raw ones, whose
            rig has the rotation of the rectification.

    Attributes:
        placement: takes the points to the left rectified camera.

    Raises:
        TopicError: as :class:`Sweeps`.
        CalibrationError: as :func:`read_extrinsics`.
    """

    def __init__(self, reader: BagReader, sensor: SensorTopic, rectified_info: str | None = None) -> None:
        self._topic, self._extrinsics = sensor.topic, sensor.extrinsics
        self._sweeps = Sweeps(reader, sensor.topic, DEFAULT_SIGMA_M)
        self._transforms = read_transforms(reader)
        of_file = None if sensor.extrinsics is None else read_extrinsics(sensor.extrinsics)
        turned = None if rectified_info is None else _rectified_from_left(reader, rectified_info)
        self.placement = Placement(self._transforms.tree, of_file, turned)
        self._counts: Counter[str] = Counter()
        self._left_out: dict[str, str] = {}
        self._moved = False

    def of(self, stamp_ns: int, rig_of: Callable[[], StereoRig]) -> Callable[[], ProjectedSweep] | None:
        """Projects the sweep of a pair, given its stamp and its rig; None where there is none in time.

        Pairs are asked for in the order of their stamps.

        Raises:
            TransformError: the sensor and the left camera are not connected.
        """
        sweep = self._sweeps.nearest(stamp_ns)
        if sweep is None:
            return None
        rig, frame = rig_of(), self._sweeps.frame_id
        self._moved = self.placement.motion_known(rig, frame)
        limit_ns = self.placement.limit_ns(rig, frame, self._sweeps.period_ns)
        if abs(sweep[0] - stamp_ns) > limit_ns + 1:
            period = f"{limit_ns / 1e6:.0f} ms, {'a' if self._moved else 'half a'} period"
            self._leave_out("far from a sweep", f"whose nearest sweep is more than {period}, away")
            return None
        try:
            self.placement.pose(rig, stamp_ns, frame, sweep[0])
        except TransformError as error:
            self._leave_out("without transform", str(error.problem))
            return None
        return lambda: self._read(stamp_ns, sweep[1], rig)

    @property
    def facts(self) -> str:
        """Where the points come from, and what of them was used so far."""
        counts = self._counts
        origin = f"transform of {self._extrinsics}" if self._extrinsics else "transform of /tf_static"
        if self._transforms.topics and not self._extrinsics:
            origin = f"transform of {', '.join(self._transforms.topics)}"
        moved = "moved to the time of each pair" if self._moved else "the motion between sweep and pair is not known"
        parts = [
            f"{self._topic}, {self._sweeps.msgtype.rpartition('/')[2]} of frame {self._sweeps.frame_id}",
            f"{counts['visible']} px of {counts['pairs']} pairs",
            f"{counts['occluded']} hidden to the camera, {counts['outside']} outside, {counts['behind']} behind",
            *([f"dropped: {text}"] if (text := self._dropped()) else []),
            origin,
            moved,
            *self.left_out,
        ]
        if self._transforms.left_out:
            parts.append(f"{self._transforms.left_out} transforms left out, {self._transforms.first}")
        return "; ".join(parts)

    @property
    def left_out(self) -> list[str]:
        """For each reason why pairs have no sweep, how many, and the first one's in words."""
        return [f"{self._counts[reason]} pairs left out, {text}" for reason, text in self._left_out.items()]

    def _read(self, stamp_ns: int, data: bytes, rig: StereoRig) -> ProjectedSweep:
        points = self._sweeps.points(data)
        in_camera = self.placement.place(points, rig, stamp_ns)
        triangulation, size = Triangulation.from_rig(rig), (rig.width, rig.height)
        seen = project(in_camera, points.sigma_m, Pose.identity(), triangulation, size)
        self._count(points, seen)
        return ProjectedSweep(in_camera, points.sigma_m, seen)

    def _count(self, points: SensorPoints, seen: SparseDisparity) -> None:
        self._counts["pairs"] += 1
        for name in ("visible", "occluded", "outside", "behind"):
            self._counts[name] += getattr(seen, name)
        for reason, count in points.dropped.items():
            self._counts[f"dropped {reason}"] += count

    def _dropped(self) -> str:
        found = {name: count for name, count in self._counts.items() if name.startswith("dropped ")}
        return ", ".join(f"{count} {name.removeprefix('dropped ')}" for name, count in found.items())

    def _leave_out(self, reason: str, text: str) -> None:
        self._counts[reason] += 1
        self._left_out.setdefault(reason, text)


def _rectified_from_left(reader: BagReader, topic: str) -> Pose | None:
    """By R of the first camera info, which those of rectified images do not count otherwise; None where it has none."""
    message = next(reader.messages([topic]), None)
    R = np.zeros((3, 3)) if message is None else camera_from_info(reader.deserialize(message)).R
    return Pose(R, np.zeros(3)) if R.any() else None

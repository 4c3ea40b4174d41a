# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The newest sweeps of a range sensor of a live graph, and their points in the left rectified image of a pair."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np

from stereo_depth_ros.camera_files.extrinsics import read_extrinsics
from stereo_depth_ros.core.errors import CalibrationError, TransformError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.range_sensor_input import RangeSensorInput
from stereo_depth_ros.nodes.transform_input import TransformInput
from stereo_depth_ros.ranging.placement import Placement
from stereo_depth_ros.ranging.projection import SparseDisparity, project
from stereo_depth_ros.ranging.sensor_points import SensorPoints

__all__ = ["PlacedSweeps"]

_SWEEPS = 10  # that are kept
_PERIOD_NS = 10**8  # of the sweeps, while it is not known


class PlacedSweeps:
    """Keeps the newest sweeps; points that are dropped are counted.

    Args:
        node: subscribes the sensor, /tf_static and /tf.
        topic: of the sensor.
        extrinsics_file: with its pose; empty takes that of /tf_static and /tf.
        setting: name of the parameter of that file, for errors.
        on_sweep: called after each sweep.

    Attributes:
        sensor: its topic and type.
        transforms: the tree of frames.

    Raises:
        CalibrationError: the file of extrinsics cannot be read.
    """

    def __init__(
        self,
        node: StereoNode,
        topic: str,
        extrinsics_file: str,
        setting: str,
        on_sweep: Callable[[], None] = lambda: None,
    ) -> None:
        self._node, self._on_sweep, self._has_file = node, on_sweep, bool(extrinsics_file)
        try:
            extrinsics = read_extrinsics(Path(extrinsics_file).expanduser()) if extrinsics_file else None
        except CalibrationError as error:
            error.settings += (setting,)
            raise
        self.transforms = TransformInput(node)
        self._placement = Placement(self.transforms.tree, extrinsics)
        self._sweeps: deque[SensorPoints] = deque(maxlen=_SWEEPS)
        self.sensor = RangeSensorInput(node, topic, self._add)

    def __len__(self) -> int:
        return len(self._sweeps)

    def in_time(self, rig: StereoRig, stamp_ns: int, late: int = 1) -> SensorPoints | None:
        """The sweep that is nearest to a time; None where it is farther than ``late`` times :meth:`Placement.limit_ns`.

        Raises:
            TransformError: as :meth:`Placement.limit_ns`.
        """
        nearest = min(self._sweeps, key=lambda sweep: abs(sweep.stamp_ns - stamp_ns), default=None)
        if nearest is None:
            return None
        gaps = np.diff(sorted(sweep.stamp_ns for sweep in self._sweeps))
        period_ns = int(np.median(gaps)) if gaps.size else _PERIOD_NS
        limit_ns = late * self._placement.limit_ns(rig, nearest.frame_id, period_ns)
        return nearest if abs(nearest.stamp_ns - stamp_ns) <= limit_ns else None

    def project(self, sweep: SensorPoints, rig: StereoRig, stamp_ns: int) -> tuple[F32, SparseDisparity]:
        """The points of a sweep in the left rectified camera at a time, float32 (N, 3), and what it sees of them.

        Raises:
            TransformError: as :meth:`Placement.place`.
        """
        points = self._placement.place(sweep, rig, stamp_ns)
        size = (rig.width, rig.height)
        return points, project(points, sweep.sigma_m, Pose.identity(), Triangulation.from_rig(rig), size)

    def missing(self, error: TransformError) -> str:
        """An error of this sensor in words, with what may be its cause."""
        if self.transforms.available or self._has_file:
            return str(error)
        return f"{error}; tf2_msgs is not installed, so that /tf_static and /tf cannot be received"

    def _add(self, points: SensorPoints) -> None:
        self._sweeps.append(points)
        for reason, count in points.dropped.items():
            self._node.diagnostics.counters[f"range points {reason}"] += count
        self._on_sweep()

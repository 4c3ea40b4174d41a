# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A range sensor of the live graph as the prior of the matcher: its newest sweep in the image of each pair."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np

from stereo_depth_ros.camera_files.extrinsics import read_extrinsics
from stereo_depth_ros.config import MatchingConfig, PriorConfig
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.core.errors import CalibrationError, ConfigError, TransformError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.range_sensor_input import RangeSensorInput
from stereo_depth_ros.nodes.transform_input import TransformInput
from stereo_depth_ros.ranging.placement import Placement
from stereo_depth_ros.ranging.projection import project
from stereo_depth_ros.ranging.sensor_points import SensorPoints

__all__ = ["PriorInput"]

_SWEEPS = 10  # that are kept
_PERIOD_NS = 10**8  # of the sweeps, while it is not known
# A sweep is received about a period after its stamp, so that the one of the time of a pair is not there yet.
_LATE = 2
_IN_TIME, _LATE_SWEEP, _UNPLACED = (
    "pairs with a prior",
    "pairs without a sweep in time",
    "pairs without a transform of the range sensor",
)


class PriorInput:
    """Keeps the newest sweeps of the sensor that the parameter prior_topic names; without a name there is no prior.

    Args:
        node: subscribes the sensor, /tf_static and /tf.

    Raises:
        CalibrationError: the file of extrinsics cannot be read.
    """

    def __init__(self, node: StereoNode) -> None:
        config = node.parameters.get(PriorConfig)
        self._node, self._topic, self._extrinsics_file = node, config.prior_topic, config.prior_extrinsics
        self._sweeps: deque[SensorPoints] = deque(maxlen=_SWEEPS)
        self._missing = ""
        if not self._topic:
            return
        try:
            extrinsics = read_extrinsics(Path(self._extrinsics_file).expanduser()) if self._extrinsics_file else None
        except CalibrationError as error:
            error.settings += ("prior_extrinsics",)
            raise
        self._transforms = TransformInput(node)
        self._placement = Placement(self._transforms.tree, extrinsics)
        self._sensor = RangeSensorInput(node, self._topic, self._on_sweep)
        node.diagnostics.watch_state(lambda: self._missing)

    def check(self, config: MatchingConfig) -> None:
        """Raise ConfigError if there is a topic, but the matcher takes no prior."""
        name = [*MATCHERS][config.stereo_algorithm]
        if self._node.parameters.get(PriorConfig).prior_topic and not MATCHERS[name].takes_prior:
            raise ConfigError(
                f"prior_topic has no effect with {name}, which takes no prior",
                value=name,
                remedy="use a matcher that does, sgm, or start without prior_topic",
                settings=("stereo_algorithm", "prior_topic"),
            )

    def of(self, rig: StereoRig, stamp_ns: int) -> DisparityPrior | None:
        """The prior of a pair; None without a sensor, a sweep in time or a transform, which is counted.

        A sweep is in time within two of its periods, or within one where the motion meanwhile is not known.
        """
        if not self._topic:
            return None
        counters = self._node.diagnostics.counters
        nearest = min(self._sweeps, key=lambda sweep: abs(sweep.stamp_ns - stamp_ns), default=None)
        try:
            if nearest is None or abs(nearest.stamp_ns - stamp_ns) > self._limit_ns(rig, nearest):
                counters[_LATE_SWEEP] += 1
                return None
            with self._node.diagnostics.timed("prior"):
                points = self._placement.place(nearest, rig, stamp_ns)
                size = (rig.width, rig.height)
                seen = project(points, nearest.sigma_m, Pose.identity(), Triangulation.from_rig(rig), size)
        except TransformError as error:
            counters[_UNPLACED] += 1
            self._missing = f"no prior of {self._sensor.topic}: {error}"
            if not self._transforms.available and not self._extrinsics_file:
                self._missing += "; tf2_msgs is not installed, so that /tf_static and /tf cannot be received"
            return None
        self._missing = ""
        counters[_IN_TIME] += 1
        return DisparityPrior(seen.disparity_px, seen.sigma_px)

    def _on_sweep(self, points: SensorPoints) -> None:
        self._sweeps.append(points)
        for reason, count in points.dropped.items():
            self._node.diagnostics.counters[f"range points {reason}"] += count

    def _limit_ns(self, rig: StereoRig, sweep: SensorPoints) -> int:
        gaps = np.diff(sorted(each.stamp_ns for each in self._sweeps))
        period_ns = int(np.median(gaps)) if gaps.size else _PERIOD_NS
        return _LATE * self._placement.limit_ns(rig, sweep.frame_id, period_ns)

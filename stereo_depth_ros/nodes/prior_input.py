# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A range sensor of the live graph as the prior of the matcher: its newest sweep in the image of each pair."""

from __future__ import annotations

from stereo_depth_ros.config import MatchingConfig, PriorConfig
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.core.errors import ConfigError, TransformError
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.placed_sweeps import PlacedSweeps

__all__ = ["PriorInput"]

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
        self._node, self._missing = node, ""
        self._sweeps: PlacedSweeps | None = None
        if not config.prior_topic:
            return
        self._sweeps = PlacedSweeps(node, config.prior_topic, config.prior_extrinsics, "prior_extrinsics")
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
        if self._sweeps is None:
            return None
        counters = self._node.diagnostics.counters
        try:
            sweep = self._sweeps.in_time(rig, stamp_ns, _LATE)
            if sweep is None:
                counters[_LATE_SWEEP] += 1
                return None
            with self._node.diagnostics.timed("prior"):
                _, seen = self._sweeps.project(sweep, rig, stamp_ns)
        except TransformError as error:
            counters[_UNPLACED] += 1
            self._missing = f"no prior of {self._sweeps.sensor.topic}: {self._sweeps.missing(error)}"
            return None
        self._missing = ""
        counters[_IN_TIME] += 1
        return DisparityPrior(seen.disparity_px, seen.sigma_px)

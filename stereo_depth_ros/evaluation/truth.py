# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""True disparities of the pairs of a bag: disparities with their stamps, or projected points of a range sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.bags.projected_sweeps import ProjectedSweeps, SensorTopic
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.evaluation.bag_score import TRUTH_TOPIC
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.ranging.projection import SparseDisparity, project

__all__ = ["DisparityTruth", "RangeTruth", "Truth", "TruthOption", "TruthSource", "open_truth"]

_DISPARITY = "stereo_msgs/msg/DisparityImage"
_SAME_PX = 1.0  # between the disparities of one surface


@dataclass(frozen=True)
class TruthOption:
    """What is taken as truth.

    Attributes:
        topic: of disparities or of a range sensor.
        extrinsics: file with the pose of the sensor; None takes that of /tf_static and /tf.
    """

    topic: str = TRUTH_TOPIC
    extrinsics: Path | None = None


@dataclass(frozen=True)
class Truth:
    """The truth of one pair.

    Attributes:
        disparity_px: float32 (H, W), x_left - x_right, NaN where unknown.
        visible: bool (H, W), whether the right camera sees the point too; None where it follows from the disparities.
    """

    disparity_px: F32
    visible: npt.NDArray[np.bool_] | None = None


class TruthSource(Protocol):
    """The truth of the pairs of a bag, asked for in the order of their stamps."""

    def of(self, stamp_ns: int, rig_of: Callable[[], StereoRig]) -> Callable[[], Truth] | None:
        """Reads the truth of a pair, given its stamp and its rig; None where there is none."""

    @property
    def facts(self) -> str:
        """Where the truth comes from, and what of it was used so far; empty for disparities."""


def open_truth(reader: BagReader, option: TruthOption, rectified_info: str | None = None) -> TruthSource:
    """The truth of a bag; see :class:`ProjectedSweeps` for ``rectified_info``.

    Raises:
        TopicError: no such topic, or a type that tells no truth.
        CalibrationError: the file of extrinsics cannot be read.
    """
    info = reader.topics.get(option.topic)
    if info is None and option.topic == TRUTH_TOPIC:
        raise TopicError(
            f"has no {TRUTH_TOPIC}, it has {', '.join(reader.topics)}",
            subject=str(reader.path),
            value=list(reader.topics),
            limit=TRUTH_TOPIC,
            remedy="convert a dataset with true disparities, synthesize a bag, or name the topic of a range sensor",
            settings=("truth",),
        )
    if info is not None and info.msgtype == _DISPARITY:
        return DisparityTruth(reader, option.topic)
    return RangeTruth(reader, option, rectified_info)


class DisparityTruth:
    """Disparities whose stamp is that of the left image."""

    facts = ""

    def __init__(self, reader: BagReader, topic: str) -> None:
        self._reader, self._topic = reader, topic
        self._truths = StampedMessages().read(reader.messages([topic]))
        self._known = next(self._truths, None)

    def of(self, stamp_ns: int, rig_of: Callable[[], StereoRig]) -> Callable[[], Truth] | None:
        """See :class:`TruthSource`; ``rig_of`` is called when the truth is read."""
        while self._known is not None and self._known[0] < stamp_ns:
            self._known = next(self._truths, None)
        if self._known is None or self._known[0] != stamp_ns:
            return None
        message = self._known[1]

        def read() -> Truth:
            return Truth(matched_disparity(self._reader.deserialize(message), rig_of(), self._topic))

        return read


class RangeTruth:
    """Points of a range sensor in the left rectified image, see :class:`ProjectedSweeps`.

    Raises:
        TopicError, CalibrationError: as :class:`ProjectedSweeps`.
    """

    def __init__(self, reader: BagReader, option: TruthOption, rectified_info: str | None = None) -> None:
        self._sweeps = ProjectedSweeps(reader, SensorTopic(option.topic, option.extrinsics), rectified_info)

    def of(self, stamp_ns: int, rig_of: Callable[[], StereoRig]) -> Callable[[], Truth] | None:
        """See :class:`TruthSource`.

        Raises:
            TransformError: the sensor and the left camera are not connected.
        """
        project_sweep = self._sweeps.of(stamp_ns, rig_of)
        if project_sweep is None:
            return None

        def read() -> Truth:
            sweep = project_sweep()
            visible = _seen_by_right(sweep.in_camera, sweep.sigma_m, rig_of(), sweep.seen)
            return Truth(sweep.seen.disparity_px, visible)

        return read

    @property
    def facts(self) -> str:
        """See :class:`TruthSource`."""
        return self._sweeps.facts


def _seen_by_right(in_camera: F32, sigma_m: float, rig: StereoRig, seen: SparseDisparity) -> npt.NDArray[np.bool_]:
    """bool (H, W): of the points that the left camera sees, those that the right one sees too."""
    right = Triangulation(rig.f_px, rig.fy_px, rig.cx_right, rig.cy, rig.baseline_m, rig.doffs_px)
    shifted = Pose(np.identity(3), np.array([-rig.baseline_m, 0.0, 0.0]))
    of_right = project(in_camera, sigma_m, shifted, right, (rig.width, rig.height)).disparity_px
    y, x = np.nonzero(seen.index >= 0)
    X, Y, Z = shifted.apply(in_camera[seen.index[y, x]].astype(np.float64)).T
    u = np.rint(right.f_px * X / Z + right.cx_px).astype(np.int64)
    v = np.rint(right.fy_px * Y / Z + right.cy_px).astype(np.int64)
    inside = (u >= 0) & (u < rig.width) & (v >= 0) & (v < rig.height)
    visible = np.zeros(seen.index.shape, np.bool_)
    # another point of its pixel is not nearer
    y, x, u, v = y[inside], x[inside], u[inside], v[inside]
    visible[y, x] = of_right[v, u] - seen.disparity_px[y, x] <= _SAME_PX
    return visible

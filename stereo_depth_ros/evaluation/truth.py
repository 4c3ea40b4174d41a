# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""True disparities of the pairs of a bag: disparities with their stamps, or projected points of a range sensor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.bags.sweeps import Sweeps
from stereo_depth_ros.bags.transforms import read_transforms
from stereo_depth_ros.camera_files.extrinsics import read_extrinsics
from stereo_depth_ros.core.errors import TopicError, TransformError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.evaluation.bag_score import TRUTH_TOPIC
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.ranging.placement import Placement
from stereo_depth_ros.ranging.projection import SparseDisparity, project
from stereo_depth_ros.ranging.sensor_points import DEFAULT_SIGMA_M, SensorPoints

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


def open_truth(reader: BagReader, option: TruthOption) -> TruthSource:
    """The truth of a bag.

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
    return RangeTruth(reader, option)


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
    """Points of a range sensor in the left rectified image.

    Of each pair the sweep with the nearest stamp is taken. Where /tf or odometry tells how the cameras move, points are
    moved to the time of the pair; elsewhere pairs are left out whose sweep is more than half a period away.

    Attributes:
        placement: takes the points to the left rectified camera.

    Raises:
        TopicError: as :class:`Sweeps`.
        CalibrationError: as :func:`read_extrinsics`.
    """

    def __init__(self, reader: BagReader, option: TruthOption) -> None:
        self._option = option
        self._sweeps = Sweeps(reader, option.topic, DEFAULT_SIGMA_M)
        self._transforms = read_transforms(reader)
        extrinsics = None if option.extrinsics is None else read_extrinsics(option.extrinsics)
        self.placement = Placement(self._transforms.tree, extrinsics)
        self._counts: Counter[str] = Counter()
        self._left_out: dict[str, str] = {}
        self._moved = False

    def of(self, stamp_ns: int, rig_of: Callable[[], StereoRig]) -> Callable[[], Truth] | None:
        """See :class:`TruthSource`.

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
        """See :class:`TruthSource`."""
        counts = self._counts
        origin = f"transform of {self._option.extrinsics}" if self._option.extrinsics else "transform of /tf_static"
        if self._transforms.topics and not self._option.extrinsics:
            origin = f"transform of {', '.join(self._transforms.topics)}"
        moved = "moved to the time of each pair" if self._moved else "the motion between sweep and pair is not known"
        parts = [
            f"{self._option.topic}, {self._sweeps.msgtype.rpartition('/')[2]} of frame {self._sweeps.frame_id}",
            f"{counts['visible']} px of {counts['pairs']} pairs",
            f"{counts['occluded']} hidden to the camera, {counts['outside']} outside, {counts['behind']} behind",
            *([f"dropped: {text}"] if (text := self._dropped()) else []),
            origin,
            moved,
            *(f"{counts[reason]} pairs left out, {text}" for reason, text in self._left_out.items()),
        ]
        if self._transforms.left_out:
            parts.append(f"{self._transforms.left_out} transforms left out, {self._transforms.first}")
        return "; ".join(parts)

    def _read(self, stamp_ns: int, data: bytes, rig: StereoRig) -> Truth:
        points = self._sweeps.points(data)
        in_camera = self.placement.place(points, rig, stamp_ns)
        triangulation, size = Triangulation.from_rig(rig), (rig.width, rig.height)
        seen = project(in_camera, points.sigma_m, Pose.identity(), triangulation, size)
        self._count(points, seen)
        return Truth(seen.disparity_px, _seen_by_right(in_camera, points.sigma_m, rig, seen))

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

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of a light stripe scanner: what moves between the images, and how the points come into one frame."""

from __future__ import annotations

import bisect
from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.pose import Pose, slerp
from stereo_depth_ros.core.types import F64

__all__ = ["MotionTrack", "StripeMotion", "Turntable", "parse_axis", "pose_matrix", "turn"]


@dataclass(frozen=True, eq=False)
class Turntable:
    """The axis of a turntable in the optical frame of a camera; positive angles turn right-handed about it.

    Attributes:
        axis: float64 (3,), its direction, of length 1.
        point_m: float64 (3,), a point of it, meters.
    """

    axis: F64
    point_m: F64


@dataclass(frozen=True, eq=False)
class StripeMotion:
    """How a number, or a pose, of each image becomes a motion.

    Attributes:
        kind: "none", "linear", "turntable" or "pose".
        moving: "object", "sensor" or "plane". A pose is that of the object in the frame of the camera, of the sensor in
            a fixed frame, or of the light plane relative to its calibration.
        axis: float64 (3,), direction of a linear motion, of length 1.
        turntable: axis of a turntable.
        rotation: float64 (3, 3), from the frame of the camera, in which all these are, to that of the points; the
            rectifying rotation where these are of a rectified image. None where both are the same.
    """

    kind: str = "none"
    moving: str = "object"
    axis: F64 | None = None
    turntable: Turntable | None = None
    rotation: F64 | None = None

    def matrix(self, value: F64) -> F64:
        """The rigid motion in the frame of the camera, float64 (4, 4).

        Args:
            value: float64 (1,), meters or radians, or (7,), a pose x, y, z, qx, qy, qz, qw; (0,) for no motion.
        """
        if self.kind == "linear":
            assert self.axis is not None
            return _rigid(np.identity(3), float(value[0]) * self.axis)
        if self.kind == "turntable":
            assert self.turntable is not None
            return turn(self.turntable, float(value[0]))
        return pose_matrix(value) if self.kind == "pose" else np.identity(4)

    def plane(self, plane: LightPlane, motion: F64) -> LightPlane:
        """The light plane in the frame of the points: another one where it moves alone.

        Args:
            plane: in the frame of the camera.
            motion: of :meth:`matrix`.
        """
        moved = plane.moved(motion) if self.moving == "plane" else plane
        return moved if self.rotation is None else moved.moved(_rigid(self.rotation, np.zeros(3)))

    def merged(self, points_m: F64, motion: F64) -> F64:
        """Points in the frame of the merged cloud, float64 (N, 3), meters.

        That is the frame of the object at motion 0, in the axes of the points; where poses are given, the frame of the
        object, or the fixed one of the sensor; and the frame of the points where only the light plane moves.

        Args:
            points_m: float64 (N, 3), meters.
            motion: of :meth:`matrix`.
        """
        if self.moving == "plane" or self.kind == "none":
            return points_m
        to_camera = np.identity(4) if self.rotation is None else _rigid(self.rotation.T, np.zeros(3))
        to_merged = (np.linalg.inv(motion) if self.moving == "object" else motion) @ to_camera
        if self.kind != "pose":
            to_merged = np.linalg.inv(to_camera) @ to_merged
        return np.asarray(points_m @ to_merged[:3, :3].T + to_merged[:3, 3], np.float64)

    def merged_frame(self, image_frame: str, pose_frame: str = "") -> str:
        """Name of the frame of the merged cloud: of the images, or of poses of the sensor, or the object's own one."""
        if self.kind != "pose" or self.moving == "plane":
            return image_frame
        return "scanned_object" if self.moving == "object" else pose_frame or image_frame


def turn(turntable: Turntable, angle_rad: float) -> F64:
    """Rotation by an angle about the axis of a turntable, float64 (4, 4) (Rodrigues 1840)."""
    rotation = np.asarray(cv2.Rodrigues(angle_rad * turntable.axis)[0], np.float64)
    return _rigid(rotation, turntable.point_m - rotation @ turntable.point_m)


def pose_matrix(pose: F64) -> F64:
    """The rigid motion, float64 (4, 4), of x, y, z, qx, qy, qz, qw; the quaternion need not have length 1."""
    return Pose.from_quaternion(pose[3:], pose[:3]).matrix


def parse_axis(text: str) -> F64:
    """A direction, float64 (3,), of length 1, from three numbers such as "0 0 1".

    Raises:
        ConfigError: not three numbers, or all of them 0.
    """
    try:
        axis = np.array([float(part) for part in text.replace(",", " ").split()])
    except ValueError:
        axis = np.zeros(0)
    length = float(np.linalg.norm(axis)) if axis.size == 3 else 0.0
    if not 0 < length < np.inf:
        raise ConfigError(
            f"linear_axis = {text!r} is not a direction",
            value=text,
            limit="three numbers, not all 0",
            remedy='write it as "0 0 1"',
            settings=("linear_axis",),
        )
    return axis / length


def _rigid(rotation: F64, translation: F64) -> F64:
    matrix = np.identity(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


class MotionTrack:
    """Numbers or poses over time, interpolated linearly, rotations along the shortest way (Shoemake 1985).

    Args:
        most: number kept; the oldest are dropped.
    """

    def __init__(self, most: int = 100_000) -> None:
        self._most = most
        self._stamps: list[int] = []
        self._values: list[F64] = []

    def add(self, stamp_ns: int, value: F64) -> None:
        """Add a value, float64 (1,) or (7,), in any order; one of the same stamp is replaced."""
        at = bisect.bisect_left(self._stamps, stamp_ns)
        if at < len(self._stamps) and self._stamps[at] == stamp_ns:
            self._values[at] = value
            return
        self._stamps.insert(at, stamp_ns)
        self._values.insert(at, value)
        if len(self._stamps) > self._most:
            del self._stamps[0], self._values[0]

    def __len__(self) -> int:
        return len(self._stamps)

    def reaches(self, stamp_ns: int) -> bool:
        """Whether a value of that time or later is known."""
        return bool(self._stamps) and self._stamps[-1] >= stamp_ns

    def at(self, stamp_ns: int) -> F64 | None:
        """The value at a time; None before the first and after the last one."""
        at = bisect.bisect_left(self._stamps, stamp_ns)
        if at == len(self._stamps) or (at == 0 and self._stamps[0] != stamp_ns):
            return None
        if self._stamps[at] == stamp_ns:
            return self._values[at]
        before, after = self._stamps[at - 1], self._stamps[at]
        share = (stamp_ns - before) / (after - before)
        return _between(self._values[at - 1], self._values[at], share)


def _between(one: F64, other: F64, share: float) -> F64:
    value = one + share * (other - one)
    if one.size == 7:
        value[3:] = slerp(one[3:] / np.linalg.norm(one[3:]), other[3:] / np.linalg.norm(other[3:]), share)
    return np.asarray(value, np.float64)

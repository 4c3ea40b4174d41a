# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Takes points of a range sensor to the left rectified camera: transforms, motion, and which sweep is in time."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.camera_files.extrinsics import Extrinsics
from stereo_depth_ros.core.errors import TransformError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.transforms import Transforms
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.ranging.projection import rectified_from_left
from stereo_depth_ros.ranging.sensor_points import SensorPoints, compensated

__all__ = ["Placement"]


class Placement:
    """Takes points from the sensor to the left rectified camera.

    Where the tree tells how the cameras move (:meth:`Transforms.motion_known`), each point is moved from its own time
    to that of the images. Elsewhere the sensor is taken to be where it is then.

    Args:
        tree: of all frames; it may grow.
        extrinsics: of a file, instead of the pose of the sensor in the tree.
        turned: pose from the left camera to the rectified one; None takes that of the rig.
    """

    def __init__(self, tree: Transforms, extrinsics: Extrinsics | None = None, turned: Pose | None = None) -> None:
        self.tree = tree
        self.turned = turned
        self._extrinsics = extrinsics

    def motion_known(self, rig: StereoRig, sensor: str) -> bool:
        """Whether points can be moved to another time.

        Args:
            rig: with the frame of the left camera.
            sensor: frame of the sensor.

        Raises:
            TransformError: the two are not connected, or one has no name.
        """
        self._connect(rig, sensor)
        return self.tree.motion_known(rig.frame_id, sensor)

    def limit_ns(self, rig: StereoRig, sensor: str, period_ns: int) -> int:
        """Longest time between images and a sweep: half a period of the sweeps, a whole one where the motion is known.

        Raises:
            TransformError: as :meth:`motion_known`.
        """
        return period_ns if self.motion_known(rig, sensor) else period_ns // 2

    def pose(self, rig: StereoRig, camera_ns: int, sensor: str, sensor_ns: int) -> Pose:
        """From the sensor at one time to the left rectified camera at another one.

        Raises:
            TransformError: the two are not connected at these times, or one has no name.
        """
        self._connect(rig, sensor)
        return self._turn(rig) @ self.tree.pose_between(rig.frame_id, camera_ns, sensor, sensor_ns)

    def place(self, points: SensorPoints, rig: StereoRig, camera_ns: int) -> F32:
        """The points in the left rectified camera at a time, float32 (N, 3), meters.

        Raises:
            TransformError: as :meth:`pose`.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # points that are not finite are not seen
            if self.motion_known(rig, points.frame_id):
                return compensated(points, lambda at: self.pose(rig, camera_ns, points.frame_id, at))
            pose = self.pose(rig, camera_ns, points.frame_id, points.stamp_ns)
            return pose.apply(points.points_m.astype(np.float64)).astype(np.float32)

    def _turn(self, rig: StereoRig) -> Pose:
        return self.turned or rectified_from_left(rig)

    def _connect(self, rig: StereoRig, sensor: str) -> None:
        """Add the pose of a file to the tree."""
        for name, frame in (("left images", rig.frame_id), ("range sensor", sensor)):
            if not frame:
                raise TransformError(
                    f"the frame of the {name} has no name",
                    value="",
                    limit="a name",
                    remedy="set frame_id of the header in its driver",
                )
        if self._extrinsics is not None:
            found = self._extrinsics
            to_left = self._turn(rig).inverse() if found.rectified else Pose.identity()
            parent = rig.frame_id if found.rectified else found.parent or rig.frame_id
            self.tree.add(parent, found.child or sensor, to_left @ found.parent_from_child)

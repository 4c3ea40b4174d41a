# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages with poses of frames, tf2_msgs/TFMessage and nav_msgs/Odometry, into a tree of frames."""

from __future__ import annotations

from typing import Any

from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.transforms import Transforms
from stereo_depth_ros.messages.motion import pose_numbers
from stereo_depth_ros.messages.types import stamp_ns

__all__ = ["ODOMETRY_TYPE", "TF_TYPE", "add_odometry", "add_transforms"]

TF_TYPE, ODOMETRY_TYPE = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"


def add_transforms(tree: Transforms, msg: Any, topic: str, *, static: bool) -> None:
    """Add all transforms of a TFMessage, of /tf_static or of /tf.

    Raises:
        MessageError: a transform whose numbers are not those of a pose.
        TransformError: as :meth:`Transforms.add`.
    """
    for transform in msg.transforms:
        pose = _pose(transform.transform.translation, transform.transform.rotation, topic)
        stamp = None if static else stamp_ns(transform.header, topic)
        tree.add(transform.header.frame_id, transform.child_frame_id, pose, stamp)


def add_odometry(tree: Transforms, msg: Any, topic: str) -> None:
    """Add the pose of an Odometry, of child_frame_id in the frame of its header.

    Raises:
        MessageError: as :func:`add_transforms`.
        TransformError: as :meth:`Transforms.add`.
    """
    pose = _pose(msg.pose.pose.position, msg.pose.pose.orientation, topic)
    tree.add(msg.header.frame_id, msg.child_frame_id, pose, stamp_ns(msg.header, topic))


def _pose(position: Any, orientation: Any, topic: str) -> Pose:
    numbers = pose_numbers(position, orientation, topic)
    return Pose.from_quaternion(numbers[3:], numbers[:3])

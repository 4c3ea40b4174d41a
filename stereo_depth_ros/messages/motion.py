# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motion messages to numpy: joints, poses, odometry and transforms, for rclpy and rosbags."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.messages.types import stamp_ns

__all__ = [
    "POSE_TYPES",
    "TREE_TYPE",
    "StampedPose",
    "joint_value",
    "pose_numbers",
    "pose_value",
    "stamped_pose",
    "tree_poses",
]


def joint_value(msg: Any, joint: str, topic: str = "") -> tuple[int, F64]:
    """Stamp, integer nanoseconds, and position, float64 (1,), of a joint in a sensor_msgs/JointState.

    Args:
        msg: the message, of any family.
        joint: name of the joint; empty takes the first one.
        topic: subject of errors.

    Raises:
        MessageError: the joint is not in it, or its position is not a finite number.
    """
    names, positions = list(msg.name), list(msg.position)
    at = names.index(joint) if joint in names else 0
    if (joint and joint not in names) or at >= len(positions):
        raise MessageError(
            f"holds no position of {quoted(joint) if joint else 'a joint'}",
            subject=topic,
            value=names,
            limit=joint,
            remedy="name one of its joints" if names else "publish the position of the axis",
            settings=("motion_joint",),
        )
    return stamp_ns(msg.header, topic), _finite(np.array([positions[at]], np.float64), topic)


def pose_value(msg: Any, topic: str = "") -> tuple[int, F64]:
    """Stamp, integer nanoseconds, and x, y, z, qx, qy, qz, qw, float64 (7,), of a geometry_msgs/PoseStamped.

    Raises:
        MessageError: as :func:`pose_numbers`.
    """
    return stamp_ns(msg.header, topic), pose_numbers(msg.pose.position, msg.pose.orientation, topic)


def pose_numbers(position: Any, orientation: Any, topic: str = "") -> F64:
    """x, y, z, qx, qy, qz, qw, float64 (7,), of the two parts of a pose or a transform.

    Raises:
        MessageError: values that are not finite, or a quaternion that is not of length 1.
    """
    p, q = position, orientation
    value = _finite(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w], np.float64), topic)
    length = float(np.linalg.norm(value[3:]))
    if not 0.5 < length < 2:
        raise MessageError(
            f"the quaternion has the length {length:g}, not 1",
            subject=topic,
            value=length,
            limit=1.0,
            remedy="publish a valid orientation",
        )
    return value


POSE_TYPES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
TREE_TYPE = "tf2_msgs/msg/TFMessage"


class StampedPose(NamedTuple):
    """The pose of a frame in its parent at a time.

    Attributes:
        stamp_ns: integer nanoseconds.
        parent, child: names of the frames; ``child`` is empty where the message does not tell it.
        pose: from the child to the parent.
    """

    stamp_ns: int
    parent: str
    child: str
    pose: Pose


def stamped_pose(msg: Any, msgtype: str, topic: str = "") -> StampedPose:
    """The pose of a message of one of POSE_TYPES.

    Raises:
        MessageError: values that are not finite, or a quaternion that is not of length 1.
    """
    if msgtype == "geometry_msgs/msg/TransformStamped":
        p, q = msg.transform.translation, msg.transform.rotation
    else:
        inner = msg.pose if msgtype == "geometry_msgs/msg/PoseStamped" else msg.pose.pose
        p, q = inner.position, inner.orientation
    value = pose_numbers(p, q, topic)
    pose = Pose.from_quaternion(value[3:], value[:3])
    return StampedPose(
        stamp_ns(msg.header, topic), str(msg.header.frame_id), str(getattr(msg, "child_frame_id", "")), pose
    )


def tree_poses(msg: Any, topic: str = "") -> list[StampedPose]:
    """The poses of a tf2_msgs/TFMessage.

    Raises:
        MessageError: as of :func:`stamped_pose`.
    """
    return [stamped_pose(transform, "geometry_msgs/msg/TransformStamped", topic) for transform in msg.transforms]


def _finite(value: F64, topic: str) -> F64:
    if not np.isfinite(value).all():
        raise MessageError(
            f"holds {value.tolist()}, which is not finite", subject=topic, value=value, remedy="check its publisher"
        )
    return value

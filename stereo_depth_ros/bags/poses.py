# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses in a bag: topics of odometry, poses and transforms, and the tree of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.transforms import STATIC_TOPIC, read_transforms
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.transforms import Transforms
from stereo_depth_ros.messages.motion import POSE_TYPES, TREE_TYPE, stamped_pose

__all__ = ["BagPoses", "pose_topics", "read_bag_poses"]


@dataclass(frozen=True, eq=False)
class BagPoses:
    """Poses of a topic.

    Attributes:
        poses: stamps in nanoseconds, and poses from ``child`` to ``parent``; empty of a topic of transforms.
        parent, child: names of the frames; ``child`` is empty where the topic does not tell it.
        tree: the frames of the bag, of all its transforms and odometry.
        is_tree: the poses are those of the tree.
        warning: what of the transforms is left out; empty where nothing is.
    """

    poses: list[tuple[int, Pose]]
    parent: str
    child: str
    tree: Transforms
    is_tree: bool
    warning: str


def pose_topics(path: Path) -> dict[str, str]:
    """The topics of a bag that hold poses over time, and their types.

    Raises:
        BagError: not a readable bag.
    """
    with BagReader(path) as reader:
        return {
            name: info.msgtype
            for name, info in reader.topics.items()
            if info.count and info.msgtype in (*POSE_TYPES, TREE_TYPE) and not name.endswith(STATIC_TOPIC)
        }


def read_bag_poses(path: Path, topic: str, max_gap_ns: int) -> BagPoses:
    """The poses of a topic, of the whole bag.

    Args:
        path: the bag.
        topic: of one of the types nav_msgs/Odometry, geometry_msgs/PoseStamped, PoseWithCovarianceStamped,
            TransformStamped, or tf2_msgs/TFMessage.
        max_gap_ns: longest time between two transforms between which others are interpolated.

    Raises:
        BagError: not a readable bag.
        TopicError: no such topic, one of another type, or one whose messages are not all poses of one frame.
        MessageError: a pose that is not finite, or whose quaternion has not length 1.
    """
    found = pose_topics(path)
    if topic not in found:
        raise TopicError(
            f"{topic} is not a topic of poses; the bag has {', '.join(found) or 'none'}",
            subject=str(path),
            value=topic,
            limit=list(found),
            remedy="name one of them, or a file of poses" if found else "give a file of poses",
            settings=("poses",),
        )
    is_tree = found[topic] == TREE_TYPE
    poses, names = [], None
    with BagReader(path) as reader:
        transforms = read_transforms(reader, max_gap_ns=max_gap_ns)
        for message in [] if is_tree else reader.messages([topic]):
            each = stamped_pose(reader.deserialize(message), message.msgtype, topic)
            poses.append((each.stamp_ns, each.pose))
            own = each.parent.removeprefix("/"), each.child.removeprefix("/")
            if names is not None and own != names:
                raise TopicError(
                    f"{topic} holds poses of several frames: {names[1] or names[0]} and {own[1] or own[0]}",
                    subject=str(path),
                    value=own,
                    limit=names,
                    remedy="name a topic of one frame",
                    settings=("poses",),
                )
            names = own
    parent, child = names or ("", "")
    lost = transforms.left_out
    warning = f"{lost} messages with transforms are left out, the first one: {transforms.first}" if lost else ""
    return BagPoses(poses, parent, child, transforms.tree, is_tree, warning)

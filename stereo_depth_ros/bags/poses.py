# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses in a bag: topics of odometry, poses and transforms, and the tree of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.frame_tree import FrameTree, frame_name
from stereo_depth_ros.core.pose_track import PoseTrack
from stereo_depth_ros.messages.motion import POSE_TYPES, TREE_TYPE, stamped_pose, tree_poses

__all__ = ["BagPoses", "pose_topics", "read_bag_poses"]

_FIXED_TOPIC, _TREE_TOPIC = "tf_static", "tf"


@dataclass(frozen=True, eq=False)
class BagPoses:
    """Poses of a topic.

    Attributes:
        track: poses over time, from ``child`` to ``parent``; empty of a topic of transforms.
        parent, child: names of the frames; ``child`` is empty where the topic does not tell it.
        tree: the frames of the bag: of /tf_static, and of the topic where it is one of transforms, else of /tf where
            the fixed ones are not all.
        is_tree: the poses are those of the tree.
    """

    track: PoseTrack
    parent: str
    child: str
    tree: FrameTree
    is_tree: bool


def pose_topics(path: Path) -> dict[str, str]:
    """The topics of a bag that hold poses over time, and their types.

    Raises:
        BagError: not a readable bag.
    """
    with BagReader(path) as reader:
        return {
            name: info.msgtype
            for name, info in reader.topics.items()
            if info.count and info.msgtype in (*POSE_TYPES, TREE_TYPE) and not name.endswith(_FIXED_TOPIC)
        }


def read_bag_poses(path: Path, topic: str, max_gap_ns: int) -> BagPoses:
    """The poses of a topic, of the whole bag.

    Args:
        path: the bag.
        topic: of one of the types nav_msgs/Odometry, geometry_msgs/PoseStamped, PoseWithCovarianceStamped,
            TransformStamped, or tf2_msgs/TFMessage.
        max_gap_ns: longest time between two poses between which others are interpolated.

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
    tree, track, names = FrameTree(max_gap_ns), PoseTrack(max_gap_ns), None
    with BagReader(path) as reader:
        trees = [name for name, info in reader.topics.items() if info.msgtype == TREE_TYPE]
        fixed = [name for name in trees if name.endswith(_FIXED_TOPIC)]
        moving = [topic] if is_tree else [name for name in trees if name.endswith(_TREE_TOPIC)]
        for message in reader.messages(moving):
            for each in tree_poses(reader.deserialize(message), message.topic):
                tree.add(each.parent, each.child, each.pose, each.stamp_ns)
        for message in reader.messages(fixed):
            for each in tree_poses(reader.deserialize(message), message.topic):
                tree.add(each.parent, each.child, each.pose)
        for message in [] if is_tree else reader.messages([topic]):
            each = stamped_pose(reader.deserialize(message), message.msgtype, topic)
            track.add(each.stamp_ns, each.pose)
            own = frame_name(each.parent), frame_name(each.child)
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
    return BagPoses(track, parent, child, tree, is_tree)

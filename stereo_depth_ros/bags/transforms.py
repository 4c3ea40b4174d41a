# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree of frames of a bag: what /tf_static, /tf and topics of odometry hold; and /tf_static of a written bag."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import MessageError, TransformError
from stereo_depth_ros.core.transforms import StaticTransform, Transforms
from stereo_depth_ros.messages.motion import TREE_TYPE, stamped_pose, tree_poses
from stereo_depth_ros.messages.types import make_header

__all__ = ["STATIC_TOPIC", "BagTransforms", "read_transforms", "write_static_transforms"]

STATIC_TOPIC, TOPIC = "/tf_static", "/tf"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"


@dataclass(frozen=True)
class BagTransforms:
    """The tree of frames of a bag.

    Attributes:
        tree: all poses.
        topics: that hold some.
        left_out: number of messages whose poses are not valid.
        first: why the first of them is left out; empty where none is.
    """

    tree: Transforms
    topics: tuple[str, ...]
    left_out: int
    first: str


def read_transforms(reader: BagReader, *, max_gap_ns: int | None = None) -> BagTransforms:
    """All poses of /tf_static, /tf, topics of the same type with these ends of their names, and odometry.

    Odometry adds the frames that have no parent otherwise. Messages that are damaged are left out and counted.

    Args:
        reader: the bag.
        max_gap_ns: as of :class:`Transforms`.

    Raises:
        BagError: the bag is damaged where it is read.
    """
    tree, odometry = Transforms(max_gap_ns=max_gap_ns), Transforms(max_gap_ns=max_gap_ns)
    names = {name: info.msgtype for name, info in reader.topics.items() if info.count}
    used = [name for name, kind in names.items() if kind == TREE_TYPE and name.endswith((STATIC_TOPIC, TOPIC))]
    used += [name for name, kind in names.items() if kind == ODOMETRY_TYPE]
    left_out, first = 0, ""
    for message in reader.messages(used) if used else ():
        try:
            found = reader.deserialize(message)
            if message.msgtype == ODOMETRY_TYPE:
                each = stamped_pose(found, ODOMETRY_TYPE, message.topic)
                odometry.add(each.parent, each.child, each.pose, each.stamp_ns)
            else:
                static = message.topic.endswith(STATIC_TOPIC)
                for each in tree_poses(found, message.topic):
                    tree.add(each.parent, each.child, each.pose, None if static else each.stamp_ns)
        except (MessageError, TransformError) as error:
            left_out += 1
            first = first or str(error.about(message.topic))
    tree.add_missing(odometry)
    return BagTransforms(tree, tuple(used), left_out, first)


def write_static_transforms(bag: BagWriter, transforms: Iterable[StaticTransform], stamp_ns: int) -> None:
    """Write all of them in one latched message on /tf_static.

    Raises:
        OutputError: it cannot be written.
    """
    types = RosbagsTypes()
    known = types.typestore.types
    stamped = []
    for each in transforms:
        x, y, z, w = map(float, each.parent_from_child.quaternion)
        a, b, c = map(float, each.parent_from_child.translation_m)
        transform = known["geometry_msgs/msg/Transform"](
            translation=known["geometry_msgs/msg/Vector3"](x=a, y=b, z=c),
            rotation=known["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        )
        header = make_header(types, stamp_ns, each.parent)
        stamped.append(
            known["geometry_msgs/msg/TransformStamped"](header=header, child_frame_id=each.child, transform=transform)
        )
    message = known[TREE_TYPE](transforms=stamped)
    bag.write_raw(STATIC_TOPIC, TREE_TYPE, types.serialize(message), stamp_ns, latched=True)

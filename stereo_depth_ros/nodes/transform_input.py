# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree of frames of a live graph, from /tf_static and /tf."""

from __future__ import annotations

import functools
import importlib.util
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from stereo_depth_ros.core.transforms import Transforms
from stereo_depth_ros.messages.motion import tree_poses
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.message_types import message_class

__all__ = ["TransformInput"]

_KEEP_NS = 10 * 10**9  # as tf2
_DEPTH = 100  # as tf2: of messages of several publishers
_TYPE = "tf2_msgs/msg/TFMessage"


class TransformInput:
    """Fills a tree of frames.

    Where tf2_msgs is not installed, as beside the wheels of ROS, nothing is subscribed.

    Args:
        node: subscribes; messages that are not valid are reported.

    Attributes:
        tree: grows while the node spins.
        available: whether transforms can be received.
    """

    def __init__(self, node: StereoNode) -> None:
        self._node = node
        self.tree = Transforms(keep_ns=_KEEP_NS)
        self.available = importlib.util.find_spec(_TYPE.partition("/")[0]) is not None
        if self.available:
            for topic, durability in (
                ("/tf_static", DurabilityPolicy.TRANSIENT_LOCAL),
                ("/tf", DurabilityPolicy.VOLATILE),
            ):
                qos = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
                node.create_subscription(message_class(_TYPE), topic, functools.partial(self.receive, topic=topic), qos)

    def receive(self, message: Any, topic: str) -> None:
        """Add the transforms of a message of /tf_static or /tf."""
        with self._node.diagnostics.catch():
            static = topic.endswith("_static")
            for each in tree_poses(message, topic):
                self.tree.add(each.parent, each.child, each.pose, None if static else each.stamp_ns)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The readiness of a node: the process ID, latched on ~/ready."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int64

from stereo_depth_ros.core.errors import GraphError

__all__ = ["announce_ready", "wait_until_ready"]

_LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_TIMEOUT_S = 30.0  # since the last progress


def announce_ready(node: Node) -> None:
    """Publish on ``~/ready``, a latched std_msgs/Int64, that this process receives messages from now on."""
    node.create_publisher(Int64, "~/ready", _LATCHED).publish(Int64(data=os.getpid()))


def wait_until_ready(
    processes: Mapping[str, int],
    progress: Callable[[], object],
    check: Callable[[], None],
    timeout_s: float = _TIMEOUT_S,
) -> None:
    """Wait until every process is ready; other nodes of these names may run in this domain.

    Args:
        processes: process ID by name of the node, in the root namespace.
        progress: a value that changes while a process starts, such as the length of its log (the first start compiles
            kernels); the timeout counts from the last change.
        check: called many times a second; raises where a process has ended.

    Raises:
        GraphError: nothing has changed for ``timeout_s`` seconds.
    """
    context = Context()
    rclpy.init(args=[], context=context)
    node = Node("stereo_depth_readiness", context=context, enable_rosout=False)
    try:
        waiting = dict(processes)

        def receive(name: str, message: Any) -> None:
            if waiting.get(name) == message.data:
                del waiting[name]

        for name in processes:
            node.create_subscription(Int64, f"/{name}/ready", lambda m, name=name: receive(name, m), _LATCHED)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        seen, changed_at = (progress(), len(waiting)), time.monotonic()
        while waiting:
            executor.spin_once(timeout_sec=0.05)
            check()
            if (now := (progress(), len(waiting))) != seen:
                seen, changed_at = now, time.monotonic()
            if time.monotonic() - changed_at > timeout_s:
                raise GraphError(
                    f"not ready, and nothing has changed for {timeout_s:g} s",
                    subject=", ".join(waiting),
                    limit=timeout_s,
                    remedy="read the log of the node, and check that ROS_DOMAIN_ID is the same",
                )
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)

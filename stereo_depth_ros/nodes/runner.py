# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs a node: transport first, then rclpy, until SIGINT or SIGTERM; exit code 0 then, 1 where it cannot start."""

from __future__ import annotations

from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node

from stereo_depth_ros.errors import StereoDepthError
from stereo_depth_ros.transport import prepare_process

__all__ = ["run"]


def run(make_node: Callable[[], Node]) -> int:
    """Make the node, spin it until a signal comes, shut down.

    Returns:
        0 after SIGINT or SIGTERM, 1 where the node refuses its parameters or topics.
    """
    prepare_process()
    node = None
    try:
        rclpy.init()
        node = make_node()
        node.get_logger().info("ready")
        rclpy.spin(node)
    except StereoDepthError as error:
        get_logger("stereo_depth_ros").fatal(str(error))
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0

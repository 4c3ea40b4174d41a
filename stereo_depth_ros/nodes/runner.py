# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs a node: sets up the transport, then rclpy; returns 0 after SIGINT or SIGTERM, 1 if it cannot start."""

from __future__ import annotations

import faulthandler
import functools
import signal
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node

from stereo_depth_ros.core.errors import GraphError, StereoDepthError
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.nodes.base import log_compilation
from stereo_depth_ros.nodes.parameters import error_text
from stereo_depth_ros.nodes.readiness import announce_ready
from stereo_depth_ros.nodes.transport import prepare_process

__all__ = ["run"]

_SHUTDOWN_TIMEOUT_S = 4.0
RCLError = rclpy_implementation.RCLError


def run(make_node: Callable[[], Node]) -> int:
    """Make the node, spin it until a signal, shut down.

    Returns:
        0 after SIGINT or SIGTERM, 1 where ROS refuses its arguments or the node its parameters or topics.
    """
    transport = prepare_process()
    interrupts: list[int] = []
    # Python's handler raises KeyboardInterrupt anywhere, in rclpy's C++ too, where it is lost or becomes another
    # error. rclpy shuts its context down by itself on a signal.
    signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number))
    node = None
    try:
        _init()
        if interrupts:
            return 0  # before rclpy handled signals
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        compile_kernels(functools.partial(log_compilation, node))
        announce_ready(node)
        node.get_logger().info(f"ready; {transport}")
        executor.spin()
    except StereoDepthError as error:
        get_logger("stereo_depth_ros").fatal(error_text(error))
        return 1
    except ExternalShutdownException:
        pass
    except RCLError:
        if rclpy.ok():
            raise
        # A signal between two calls: the context is shut down.
    finally:
        # Fast DDS 2.14 can hang while it deletes a participant, with the interpreter lock held: then the process ends,
        # with exit code 1 and the traceback, from a thread that needs no lock.
        faulthandler.dump_traceback_later(_SHUTDOWN_TIMEOUT_S, exit=True)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()
    return 0


def _init() -> None:
    try:
        rclpy.init()
    except RCLError as error:
        raise GraphError(
            f"ROS does not start: {error}", remedy="check the arguments after --ros-args, and ROS_DOMAIN_ID"
        ) from error

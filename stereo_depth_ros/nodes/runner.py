# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs a node: sets up the transport, then rclpy; returns 0 after SIGINT, SIGTERM or --help, 1 if it cannot start."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import functools
import inspect
import os
import sys

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger

from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.core.interrupts import ended_within, handled_signals
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.core.overlap import BESIDE_WORK
from stereo_depth_ros.nodes.base import StereoNode, log_compilation
from stereo_depth_ros.nodes.command_line import answer_help, start_ros
from stereo_depth_ros.nodes.interface import COMMON_OUTPUTS
from stereo_depth_ros.nodes.log import log_fatal, log_info
from stereo_depth_ros.nodes.parameters import error_text
from stereo_depth_ros.nodes.readiness import announce_ready
from stereo_depth_ros.nodes.spinning import spin_overlapped
from stereo_depth_ros.nodes.transport import prepare_process
from stereo_depth_ros.stages.disparity import LARGEST_AT_ONCE

__all__ = ["run"]

_END_S = 1.0  # after a signal, for the frame in work and the shutdown
_SHUTDOWN_TIMEOUT_S = 4.0
RCLError = rclpy_implementation.RCLError


class _Executor(SingleThreadedExecutor):  # type: ignore[misc]
    """Its end writes nothing where the context was shut down before it by a signal."""

    def __del__(self) -> None:
        with contextlib.suppress(rclpy_implementation.InvalidHandle):
            super().__del__()


def run(node_type: type[StereoNode]) -> int:
    """Make the node, spin it until a signal, shut down; or print its help.

    Returns:
        0 after SIGINT, SIGTERM or the help, 1 where ROS refuses its arguments or the node its parameters or topics.
    """
    about = f"{inspect.getdoc(sys.modules[node_type.__module__])}\n\n{inspect.getdoc(node_type)}"
    interface = dataclasses.replace(node_type.interface, outputs={**node_type.interface.outputs, **COMMON_OUTPUTS})
    if answer_help(interface, about, sys.argv):
        return 0
    interrupts: list[int] = []
    # Python's own handler raises KeyboardInterrupt anywhere, in rclpy's C++ too, where it is lost or becomes another
    # error. rclpy shuts its context down by itself on a signal. A frame of a slow matcher or the compilation of a
    # kernel goes on for long after it: then the process ends where it is.
    with handled_signals(
        lambda number, _: interrupts.append(number), _END_S, _flush_logs, functools.partial(os._exit, 0)
    ):
        return _run(node_type, interrupts)


def _flush_logs() -> None:
    """rcutils buffers its log where it goes to stdout."""
    ctypes.CDLL(None).fflush(None)


def _run(node_type: type[StereoNode], interrupts: list[int]) -> int:
    transport = prepare_process()
    node = None
    try:
        start_ros(sys.argv)
        if interrupts:
            return 0  # before rclpy handled signals
        node = node_type()
        executor = _Executor()
        executor.add_node(node)
        compile_kernels(functools.partial(log_compilation, node))
        announce_ready(node)
        for line in (str(transport), *node.readiness()):
            log_info(node.get_logger(), line)
        if node.frames is None:
            executor.spin()
        else:
            node.frames.begin_overlap()
            spin_overlapped(executor, node.frames.run_one, threads=LARGEST_AT_ONCE + BESIDE_WORK + 1)
    except StereoDepthError as error:
        log_fatal(get_logger("stereo_depth_ros"), error_text(error))
        return 1
    except ExternalShutdownException:
        pass
    except RCLError:
        if rclpy.ok():
            raise
        # A signal between two calls: the context is shut down.
    finally:
        # Fast DDS 2.14 can hang while it deletes a participant, with the interpreter lock held.
        with ended_within(_SHUTDOWN_TIMEOUT_S, exit_code=0 if interrupts else 1):
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
    return 0

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Command line of a node: its help, and the start of ROS with one line on arguments that are not valid."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import remove_ros_args

from stereo_depth_ros.core.errors import GraphError
from stereo_depth_ros.nodes.interface import NodeInterface

__all__ = ["answer_help", "start_ros"]

_HELP = ("-h", "--help")
_SOURCE_LINE = re.compile(r", at \S+:\d+")  # where in rcl an error was found


def answer_help(interface: NodeInterface, about: str, arguments: Sequence[str]) -> bool:
    """Write the help to stdout where the arguments ask for it, also after ``--ros-args``.

    Args:
        interface: of the node.
        about: paragraphs on what it does.
        arguments: those of the process, with its name.

    Returns:
        True if they ask for it.
    """
    asked = any(argument in _HELP for argument in arguments[1:])
    if asked:
        sys.stdout.write(interface.help(about))
    return asked


def start_ros(arguments: Sequence[str]) -> None:
    """Initialize rclpy.

    Args:
        arguments: those of the process, with its name.

    Raises:
        GraphError: ROS refuses its arguments or its environment, or there are arguments of another kind.
    """
    try:
        rclpy.init(args=[*arguments])
    except rclpy_implementation.UnknownROSArgsError as error:
        names = " ".join(re.findall(r"'(.+?)'", str(error)))
        raise GraphError(f"unknown ROS argument {names}", value=names, remedy="see --help") from error
    except rclpy_implementation.RCLError as error:
        raise GraphError(
            f"ROS does not start: {_SOURCE_LINE.sub('', str(error)).rstrip('.')}",
            remedy="check the arguments after --ros-args, and ROS_DOMAIN_ID",
        ) from error
    others = " ".join(remove_ros_args([*arguments])[1:])
    if others:
        raise GraphError(
            f"unknown argument {others}", value=others, remedy="give parameters and topics after --ros-args, see --help"
        )

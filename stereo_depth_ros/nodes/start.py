# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Starts the program of a node; a signal while it is imported ends the process with exit code 0 and no traceback."""

from __future__ import annotations

import functools
import importlib
import os
import signal

__all__ = [
    "calibration_monitor",
    "calibration_node",
    "depth_node",
    "disparity_node",
    "end_at_once",
    "feature_node",
    "light_stripe_node",
    "point_cloud_node",
    "rectify_node",
    "replay_node",
    "stereo_depth_node",
    "structured_light_node",
    "view_node",
]


def end_at_once() -> None:
    """End the process on a signal, until the node has handlers of its own: nothing has been started yet."""
    end = functools.partial(os._exit, 0)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: end())


def _start(node: str) -> int:
    end_at_once()
    return int(importlib.import_module(f"stereo_depth_ros.nodes.{node}").main())


# Entry points of the executables
calibration_monitor = functools.partial(_start, "calibration_monitor")
calibration_node = functools.partial(_start, "calibration_node")
depth_node = functools.partial(_start, "depth_node")
disparity_node = functools.partial(_start, "disparity_node")
feature_node = functools.partial(_start, "feature_node")
light_stripe_node = functools.partial(_start, "light_stripe_node")
point_cloud_node = functools.partial(_start, "point_cloud_node")
rectify_node = functools.partial(_start, "rectify_node")
replay_node = functools.partial(_start, "replay_node")
stereo_depth_node = functools.partial(_start, "stereo_depth_node")
structured_light_node = functools.partial(_start, "structured_light_node")
view_node = functools.partial(_start, "view_node")

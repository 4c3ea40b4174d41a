# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the package: one root; every message names the value, the limit and the remedy."""

__all__ = [
    "BagError",
    "CalibrationError",
    "ConfigError",
    "GraphError",
    "ImageError",
    "MessageError",
    "StereoDepthError",
    "TopicError",
]


class StereoDepthError(Exception):
    """Root of everything this package raises on purpose."""


class ConfigError(StereoDepthError):
    """A parameter has an unknown name, a wrong type, a value out of range, or contradicts another."""


class CalibrationError(StereoDepthError):
    """Camera matrices or camera infos that cannot describe this stereo rig."""


class ImageError(StereoDepthError):
    """Pixels that cannot be used: wrong shape, dtype, or sizes that disagree."""


class MessageError(StereoDepthError):
    """A message whose fields contradict each other, or that this package does not read."""


class BagError(StereoDepthError):
    """A bag or dataset that cannot be opened, read or written."""


class TopicError(StereoDepthError):
    """Topics that are missing, ambiguous, equal, or of the wrong type."""


class GraphError(StereoDepthError):
    """The ROS graph is not there, a node of it ended, or a topic has nobody at its other end."""

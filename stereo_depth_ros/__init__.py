# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stereo depth for ROS 2: rectification, disparity, depth and point clouds. What a program calls is here."""

from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import Frame, MatchResult, Reason, StereoPair
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.pipeline import StereoPipeline, StereoResult

__all__ = [
    "CameraModel",
    "Frame",
    "MatchResult",
    "MatchingConfig",
    "PipelineConfig",
    "Reason",
    "StereoDepthError",
    "StereoPair",
    "StereoPipeline",
    "StereoResult",
    "StereoRig",
    "create_matcher",
]

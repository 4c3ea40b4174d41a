# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: one frozen dataclass per stage and per matching method, the single source of all parameter metadata."""

from stereo_depth_ros.config.light_stripe import LightStripeConfig, StripeMotionConfig
from stereo_depth_ros.config.matching import MatchingConfig
from stereo_depth_ros.config.parameter import ParameterInfo, parameter_infos, replace_checked, unknown_parameter
from stereo_depth_ros.config.stages import (
    CONFIGS,
    CalibrationConfig,
    CalibrationMonitorConfig,
    CameraInfoConfig,
    CloudConfig,
    DepthConfig,
    PairingConfig,
    PipelineConfig,
    PointConfig,
    PriorConfig,
    RectificationConfig,
    ViewConfig,
)
from stereo_depth_ros.config.structured_light import StructuredLightConfig

__all__ = [
    "CONFIGS",
    "CalibrationConfig",
    "CalibrationMonitorConfig",
    "CameraInfoConfig",
    "CloudConfig",
    "DepthConfig",
    "LightStripeConfig",
    "MatchingConfig",
    "PairingConfig",
    "ParameterInfo",
    "PipelineConfig",
    "PointConfig",
    "PriorConfig",
    "RectificationConfig",
    "StripeMotionConfig",
    "StructuredLightConfig",
    "ViewConfig",
    "parameter_infos",
    "replace_checked",
    "unknown_parameter",
]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: one frozen dataclass per stage and per matching method, the single source of all parameter metadata."""

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
    RectificationConfig,
    ViewConfig,
)

__all__ = [
    "CONFIGS",
    "CalibrationConfig",
    "CalibrationMonitorConfig",
    "CameraInfoConfig",
    "CloudConfig",
    "DepthConfig",
    "MatchingConfig",
    "PairingConfig",
    "ParameterInfo",
    "PipelineConfig",
    "RectificationConfig",
    "ViewConfig",
    "parameter_infos",
    "replace_checked",
    "unknown_parameter",
]

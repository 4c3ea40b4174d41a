# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stereo depth for ROS 2: rectification, disparity, depth and point clouds. The public API, imported on first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stereo_depth_ros.camera_files.reading import read_rig_files
    from stereo_depth_ros.config import MatchingConfig, PipelineConfig
    from stereo_depth_ros.core.camera import CameraModel
    from stereo_depth_ros.core.errors import (
        BagError,
        CalibrationError,
        CameraOrderError,
        ConfigError,
        GraphError,
        ImageError,
        MessageError,
        OutputError,
        RegistrationError,
        StereoDepthError,
        TopicError,
        TransformError,
    )
    from stereo_depth_ros.core.rig import StereoRig
    from stereo_depth_ros.core.types import Frame, MatchResult, Reason, StereoPair
    from stereo_depth_ros.core.version import __version__
    from stereo_depth_ros.matching import create_matcher
    from stereo_depth_ros.offline.pairs import read_pairs
    from stereo_depth_ros.pipeline import StereoPipeline, StereoResult

__all__ = [
    "BagError",
    "CalibrationError",
    "CameraModel",
    "CameraOrderError",
    "ConfigError",
    "Frame",
    "GraphError",
    "ImageError",
    "MatchResult",
    "MatchingConfig",
    "MessageError",
    "OutputError",
    "PipelineConfig",
    "Reason",
    "RegistrationError",
    "StereoDepthError",
    "StereoPair",
    "StereoPipeline",
    "StereoResult",
    "StereoRig",
    "TopicError",
    "TransformError",
    "__version__",
    "create_matcher",
    "read_pairs",
    "read_rig_files",
]

_NAMES = {
    "camera_files.reading": ("read_rig_files",),
    "config": ("MatchingConfig", "PipelineConfig"),
    "core.camera": ("CameraModel",),
    "core.errors": (
        *("BagError", "CalibrationError", "CameraOrderError", "ConfigError", "GraphError", "ImageError"),
        *("MessageError", "OutputError", "RegistrationError", "StereoDepthError", "TopicError", "TransformError"),
    ),
    "core.rig": ("StereoRig",),
    "core.types": ("Frame", "MatchResult", "Reason", "StereoPair"),
    "core.version": ("__version__",),
    "matching": ("create_matcher",),
    "offline.pairs": ("read_pairs",),
    "pipeline": ("StereoPipeline", "StereoResult"),
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A name of the public API, from its module (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

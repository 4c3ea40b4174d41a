# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The line that an error becomes on the command line: its text, and the options that the remedy is about."""

from __future__ import annotations

from stereo_depth_ros.config import CONFIGS, parameter_infos
from stereo_depth_ros.core.errors import StereoDepthError

__all__ = ["error_line"]


def error_line(error: StereoDepthError | OSError) -> str:
    """One line; the names in ``error.settings`` become options."""
    settings = getattr(error, "settings", ())
    options = f" ({', '.join(_option(name) for name in settings)})" if settings else ""
    return f"error: {error}{options}"


def _option(setting: str) -> str:
    parameters = {info.name for config in CONFIGS.values() for info in parameter_infos(config)}
    return f"--param {setting}:=..." if setting in parameters else f"--{setting.replace('_', '-')}"

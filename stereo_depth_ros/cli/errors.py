# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors as text of the command line: one line, with the options that the remedy is about."""

from __future__ import annotations

from stereo_depth_ros.config import CONFIGS, parameter_infos
from stereo_depth_ros.core.errors import StereoDepthError

__all__ = ["error_line", "error_text"]


def error_line(error: StereoDepthError | OSError) -> str:
    """``error: `` and the text of the error on one line."""
    return f"error: {error_text(error)}"


def error_text(error: StereoDepthError | OSError) -> str:
    """The text of the error on one line; the names in ``error.settings`` become options."""
    if isinstance(error, OSError):
        parts = (error.filename, error.strerror or str(error))
        return ": ".join(str(part) for part in parts if part)
    options = f" ({', '.join(_option(name) for name in error.settings)})" if error.settings else ""
    return " ".join(f"{error}{options}".splitlines())


def _option(setting: str) -> str:
    parameters = {info.name for config in CONFIGS.values() for info in parameter_infos(config)}
    return f"--param {setting}:=..." if setting in parameters else f"--{setting.replace('_', '-')}"

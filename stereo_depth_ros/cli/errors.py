# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors as text of the command line: one line, with the options that the remedy is about."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from stereo_depth_ros.config import CONFIGS, parameter_infos
from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.core.in_words import in_words

__all__ = ["command_options", "error_line", "error_text", "given_value", "param_options"]


def command_options(command: Any) -> set[str]:
    """The options of a command and of its subcommands, such as ``--left``."""
    options = {option for parameter in command.params for option in parameter.opts}
    return options.union(*(command_options(each) for each in getattr(command, "commands", {}).values()))


def error_line(error: StereoDepthError | OSError, options: Collection[str] | None = None) -> str:
    """``error: `` and :func:`error_text`."""
    return f"error: {error_text(error, options)}"


def error_text(error: StereoDepthError | OSError, options: Collection[str] | None = None) -> str:
    """The text of the error on one line; the names in ``error.settings`` become options of the command.

    Args:
        error: the error.
        options: options of the command, others are not named; None allows all.
    """
    if isinstance(error, OSError):
        return ": ".join(str(part) for part in (error.filename, in_words(error)) if part)
    found = [option for name in error.settings if (option := _option(name, options))]
    text = f"{error} ({', '.join(found)})" if found else str(error)
    return " ".join(text.split("\n"))


def given_value(error: Any) -> str:
    """The value that typer refuses, where its message lacks it: `` (given: 0)``; else an empty string."""
    errors = getattr(error.__cause__, "errors", None)  # of pydantic, whose messages state only the limit
    refused: list[Any] = errors() if callable(errors) else []
    return f" (given: {refused[0]['input']})" if refused else ""


def param_options(values: Mapping[str, bool | int | float | str]) -> str:
    """Parameter values as options: ``--param name:=value ...``."""
    return " ".join(f"--param {name}:={_value_text(value)}" for name, value in values.items())


def _value_text(value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _option(setting: str, options: Collection[str] | None) -> str | None:
    """The option of that name, also without a unit at its end, or the parameter; None if the command has neither."""
    option = f"--{setting.replace('_', '-')}"
    is_parameter = setting in _parameters()
    if options is None:
        return f"--param {setting}:=..." if is_parameter else option
    for name in (option, option.rpartition("-")[0]):
        if name in options:
            return name
    return f"--param {setting}:=..." if is_parameter and "--param" in options else None


def _parameters() -> set[str]:
    """Names for ``--param``: all but those of calibration_node, which are options of calibrate."""
    stages = (config for name, config in CONFIGS.items() if name != "calibration")
    return {info.name for config in stages for info in parameter_infos(config)}

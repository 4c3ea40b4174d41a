# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The option `--camera-info LEFT RIGHT` of several commands: calibration files in place of camera infos."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from stereo_depth_ros.camera_files.reading import rig_file_paths
from stereo_depth_ros.camera_files.stored import Size
from stereo_depth_ros.config.values import Value
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.quoted import quoted

__all__ = ["CameraInfo", "CommandWithCameraInfo", "ImageSize", "camera_info_values", "parse_size"]

_OPTIONS = ("--camera-info", "--rig")
_SUFFIXES = (".yaml", ".yml", ".xml", ".json", ".txt", ".ini", ".gz", ".tgz", ".tar")
_URLS = ("left_camera_info_url", "right_camera_info_url")

CameraInfo = Annotated[
    list[Path] | None,
    typer.Option(
        "--camera-info",
        metavar="LEFT RIGHT",
        help="Use these calibration files instead of the camera infos: one a camera, or one that holds both.",
    ),
]
ImageSize = Annotated[
    str | None,
    typer.Option(
        "--size", metavar="640x480", help="Set the size of the images, for calibration files that do not state it."
    ),
]


class CommandWithCameraInfo(TyperCommand):
    """A command with the option; its second file follows the first one without a name."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options."""
        return super().parse_args(ctx, _expanded(args))


def camera_info_values(files: Sequence[Path] | None, given: Mapping[str, Value]) -> dict[str, Value]:
    """The parameters of the nodes that read these files; none without files.

    Args:
        files: the values of the option.
        given: parameters on the command line.

    Raises:
        CalibrationError: more files than a rig has, or one that cannot be read.
        ConfigError: the files are given as parameters too.
    """
    if not files:
        return {}
    if repeated := [name for name in _URLS if name in given]:
        raise ConfigError(
            f"--camera-info and --param {repeated[0]} contradict each other",
            value=given[repeated[0]],
            remedy="give one of them",
        )
    rig_file_paths(files)  # names what cannot be read before anything runs
    left, right, *_ = [*(str(path.absolute()) for path in files), ""]
    return {_URLS[0]: left, _URLS[1]: right}


def parse_size(text: str | None) -> Size | None:
    """Width and height of a text such as 640x480; None of None.

    Raises:
        ConfigError: another form.
    """
    if text is None:
        return None
    words = text.lower().split("x")
    if len(words) != 2 or not all(re.fullmatch("[1-9][0-9]{0,8}", word) for word in words):
        raise ConfigError(
            f"size {quoted(text)} is not a width and a height",
            value=text,
            limit="WIDTHxHEIGHT",
            remedy="write it as 640x480",
            settings=("size",),
        )
    return int(words[0]), int(words[1])


def _expanded(args: Sequence[str]) -> list[str]:
    """The arguments with the name of the option before its second file."""
    expanded: list[str] = []
    for argument in args:
        before = expanded[-2] if len(expanded) > 1 else ""
        last = expanded[-1] if expanded else ""
        name = before if before in _OPTIONS and last != "--" else last.partition("=")[0]
        is_first = name in _OPTIONS and (before == name or "=" in last)
        given = sum(each.partition("=")[0] == name for each in expanded)
        if is_first and given == 1 and not argument.startswith("-") and argument.lower().endswith(_SUFFIXES):
            expanded.append(name)
        expanded.append(argument)
    return expanded

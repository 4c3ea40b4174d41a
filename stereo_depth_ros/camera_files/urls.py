# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera info URLs by the rules of ``camera_info_manager``: file:///, package://, ${ROS_HOME}, ${NAME}; and paths."""

from __future__ import annotations

import os
from pathlib import Path

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.quoted import quoted

__all__ = ["camera_info_paths"]

_FILE, _PACKAGE = "file://", "package://"
_REMEDY = "write file:///PATH, package://PACKAGE/PATH, or a path"


def camera_info_paths(left_url: str, right_url: str) -> tuple[Path, ...]:
    """The calibration files of two URLs; none where both are empty, one where that of the right camera is.

    Raises:
        ConfigError: only the right one is set, a URL of another kind, or a package that is not installed.
    """
    if right_url and not left_url:
        raise ConfigError(
            "right_camera_info_url is set and left_camera_info_url is not",
            value="",
            remedy="set both, or the left one to a file that holds both cameras",
            settings=("left_camera_info_url",),
        )
    urls = {"left": left_url, "right": right_url}
    return tuple(_path(url, side) for side, url in urls.items() if url)


def _path(url: str, side: str) -> Path:
    ros_home = os.environ.get("ROS_HOME") or str(Path.home() / ".ros")
    resolved = url.replace("${NAME}", side).replace("${ROS_HOME}", ros_home)
    if resolved.lower().startswith(f"{_FILE}/"):
        return Path(resolved[len(_FILE) :])
    if resolved.lower().startswith(_PACKAGE):
        return _in_package(resolved[len(_PACKAGE) :], url, side)
    if "://" in resolved or "${" in resolved:
        raise _refused(f"{quoted(url)} is not a URL of a file", url, side)
    return Path(resolved)


def _in_package(place: str, url: str, side: str) -> Path:
    """A path in the share folder of a package, which the index of ament lists."""
    package, _, path = place.partition("/")
    if not package or not path:
        raise _refused(f"{quoted(url)} lacks the package or the path", url, side)
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and (Path(prefix) / "share" / "ament_index" / "resource_index" / "packages" / package).is_file():
            return Path(prefix) / "share" / package / path
    raise _refused(f"{quoted(url)}: there is no package {quoted(package)} in AMENT_PREFIX_PATH", url, side)


def _refused(problem: str, url: str, side: str) -> ConfigError:
    return ConfigError(problem, value=url, limit=_REMEDY, remedy=_REMEDY, settings=(f"{side}_camera_info_url",))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Prepares a process for large messages: free shared memory; a Fast DDS profile and malloc settings, unless set."""

from __future__ import annotations

import ctypes
import os
from collections.abc import MutableMapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.files.installed_files import installed_files
from stereo_depth_ros.nodes.shared_memory import remove_dead_segments

__all__ = ["Setting", "TransportReport", "prepare_process", "profile_path"]

# The names that Fast DDS reads, 2.x the first one and 3.x (ROS 2 Kilted) the second one
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
WORKING_FOLDER_PROFILE = "DEFAULT_FASTRTPS_PROFILES.xml"  # Fast DDS 2.x reads this one too, from where it is started
MALLOC_VARIABLE = "STEREO_DEPTH_MALLOPT"
SHARED_MEMORY = Path("/dev/shm")
SEGMENT_OVERHEAD = 1.1  # a segment of 128 MiB takes 134 MiB, measured with Fast DDS 2.14

# Names and numbers of glibc's malloc.h; returning a buffer to the system causes page faults at the next frame. The mmap
# threshold is the largest that glibc accepts.
MALLOC_OPTIONS = {
    "M_MMAP_THRESHOLD": (-3, 32 << 20),
    "M_TRIM_THRESHOLD": (-1, 1 << 30),
    "M_TOP_PAD": (-2, 64 << 20),
    "M_ARENA_MAX": (-8, 1),
}


@dataclass(frozen=True)
class Setting:
    """Whether a setting was applied, and a text on what was applied or why not."""

    applied: bool
    text: str


@dataclass(frozen=True)
class TransportReport:
    """What :func:`prepare_process` did; ``str()`` is a line for the log."""

    profile: Setting
    malloc: Setting
    freed_bytes: int = 0

    def __str__(self) -> str:
        freed = f"; removed {self.freed_bytes >> 20} MiB of shared memory of killed processes"
        return f"transport: {self.profile.text}; memory: {self.malloc.text}{freed if self.freed_bytes else ''}"


def prepare_process() -> TransportReport:
    """Applies the Fast DDS profile and the malloc settings to this process; call it before ``rclpy.init()``.

    The profile is not set when the user chose one, other built-in transports or another middleware; the malloc
    settings when the user set ``MALLOC_*`` or ``GLIBC_TUNABLES``, or ``STEREO_DEPTH_MALLOPT=0``. Processes started
    from this one inherit the profile, not the malloc settings. It may be called more than once. Shared memory that
    killed processes of this user left behind is removed first, so that there is room for a segment.

    Raises:
        ConfigError: the package is installed without its profile.
    """
    freed = remove_dead_segments(SHARED_MEMORY)
    return TransportReport(profile=_set_profile(os.environ), malloc=_set_malloc(os.environ), freed_bytes=freed)


def profile_path() -> Path:
    """The Fast DDS profile: in ``config/`` of the source tree, or in ``share/stereo_depth_ros/config`` of the prefix.

    Raises:
        ConfigError: it is in neither.
    """
    for path in installed_files("config/fastdds.xml"):
        return path
    raise ConfigError(
        "there is no config/fastdds.xml", subject=__file__, remedy="install the package again, with its share folder"
    )


def _set_profile(environment: MutableMapping[str, str]) -> Setting:
    profile = profile_path()
    reason = _reason_against_profile(environment, profile)
    if reason:
        return Setting(False, f"Fast DDS profile not set, {reason}")
    environment.update(dict.fromkeys(PROFILE_VARIABLES, str(profile)))
    return Setting(True, f"Fast DDS profile {profile}")


def _reason_against_profile(environment: MutableMapping[str, str], profile: Path) -> str:
    """Why the profile must not be set, or an empty string."""
    middleware = environment.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp"
    if not middleware.startswith("rmw_fastrtps"):
        return f"RMW_IMPLEMENTATION is {middleware}: set up shared memory there"
    for variable in PROFILE_VARIABLES:
        if environment.get(variable, str(profile)) != str(profile):
            return f"{variable} is {environment[variable]!r}"
    if "FASTDDS_BUILTIN_TRANSPORTS" in environment:
        return f"FASTDDS_BUILTIN_TRANSPORTS is {environment['FASTDDS_BUILTIN_TRANSPORTS']}"
    if environment.get("SKIP_DEFAULT_XML_FILE") != "1" and Path(WORKING_FOLDER_PROFILE).is_file():
        return f"{Path(WORKING_FOLDER_PROFILE).resolve()} is read"
    return _reason_against_segment(profile)


def _reason_against_segment(profile: Path) -> str:
    """Why the shared-memory segment of the profile does not fit, or an empty string."""
    size = next(
        int(element.text or 0) for element in ElementTree.parse(profile).iter() if element.tag.endswith("segment_size")
    )
    if not SHARED_MEMORY.is_dir():
        return ""
    needed = int(size * SEGMENT_OVERHEAD)
    status = os.statvfs(SHARED_MEMORY)
    free = status.f_bavail * status.f_frsize
    if free >= needed:
        return ""
    return (
        f"{SHARED_MEMORY} has {free >> 20} MiB free and a process needs {needed >> 20}: free some or enlarge it "
        "(docker run --shm-size=1g); until then large messages to best-effort subscribers are lost"
    )


def _set_malloc(environment: MutableMapping[str, str]) -> Setting:
    reason = _reason_against_malloc(environment)
    if reason:
        return Setting(False, f"malloc not set, {reason}")
    mallopt = ctypes.CDLL(None).mallopt
    refused = [name for name, (number, value) in MALLOC_OPTIONS.items() if mallopt(number, value) != 1]
    if refused:
        return Setting(False, f"malloc refused {', '.join(refused)}: image buffers are mapped again for every frame")
    return Setting(True, "malloc keeps large buffers")


def _reason_against_malloc(environment: MutableMapping[str, str]) -> str:
    """Why malloc must not be set, or an empty string."""
    if environment.get(MALLOC_VARIABLE) == "0":
        return f"{MALLOC_VARIABLE} is 0"
    own = sorted(name for name in environment if name.startswith("MALLOC_") or name == "GLIBC_TUNABLES")
    if own:
        return f"{', '.join(own)} set"
    if os.name != "posix" or not hasattr(ctypes.CDLL(None), "gnu_get_libc_version"):
        return "the C library is not glibc"
    return ""

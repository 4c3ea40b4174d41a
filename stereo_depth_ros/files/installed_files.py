# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data files of the package, in the source tree or in share/stereo_depth_ros of the install prefix."""

from __future__ import annotations

from pathlib import Path

__all__ = ["installed_files"]


def installed_files(pattern: str) -> list[Path]:
    """Files that match a pattern such as ``bags/*.mcap``, sorted, in the first location with any; empty if none has."""
    here = Path(__file__).resolve()
    shares = (folder / "share" / "stereo_depth_ros" for folder in here.parents)
    for root in (here.parents[2], *shares):
        found = sorted(path for path in root.glob(pattern) if path.is_file())
        if found:
            return found
    return []

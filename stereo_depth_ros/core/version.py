# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Version of the installed package."""

from __future__ import annotations

from importlib import metadata

__all__ = ["__version__"]


def _installed_version() -> str:
    """The version in the metadata; "unknown" where the package runs from a folder that was never installed."""
    try:
        return metadata.version("stereo_depth_ros")
    except metadata.PackageNotFoundError:
        return "unknown"


__version__ = _installed_version()

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The public API: complete, typed, and imported on first use only."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata

import pytest

import stereo_depth_ros
from stereo_depth_ros.core import errors, version

HEAVY = ("numpy", "cv2", "numba", "stereo_depth_ros.pipeline")


def imported_after(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(*(name for name in {HEAVY} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    return set(done.stdout.split())


def test_import_is_light() -> None:
    assert imported_after("import stereo_depth_ros; dir(stereo_depth_ros)") == set()
    assert imported_after("from stereo_depth_ros import __version__, ConfigError") == set()


def test_names_are_imported_on_first_use() -> None:
    assert imported_after("from stereo_depth_ros import StereoPipeline") == set(HEAVY)


def test_every_name_is_available() -> None:
    for name in stereo_depth_ros.__all__:
        value = getattr(stereo_depth_ros, name)
        assert name == "__version__" or value.__name__ == name
    assert set(stereo_depth_ros.__all__) == set(stereo_depth_ros._MODULES)
    assert set(stereo_depth_ros.__all__) <= set(dir(stereo_depth_ros))


def test_every_error_is_public() -> None:
    assert {name for name in errors.__all__ if name.endswith("Error")} <= set(stereo_depth_ros.__all__)


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match=r"'stereo_depth_ros' has no attribute 'StereoPipline'"):
        _ = stereo_depth_ros.StereoPipline
    with pytest.raises(ImportError, match="StereoPipline"):
        from stereo_depth_ros import StereoPipline  # noqa: F401


def test_version(monkeypatch: pytest.MonkeyPatch) -> None:
    assert stereo_depth_ros.__version__ == metadata.version("stereo_depth_ros")

    def not_installed(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", not_installed)
    assert version._installed_version() == "unknown"

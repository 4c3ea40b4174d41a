# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def stereo_data() -> Path:
    """The folder of real pairs and sequences; tests that need it are skipped where it is not."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STEREO_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}: set STEREO_DATA")
    return folder

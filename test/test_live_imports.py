# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live nodes import only packages that apt has for ROS 2; replay reads bags and needs more."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="the nodes need ROS 2")

pytestmark = pytest.mark.graph

ROOT = Path(__file__).resolve().parents[1]
# rosbags with what it brings, and the packages of the command line
NOT_IN_APT = ("rosbags", "mcap", "lz4", "zstandard", "apsw", "ruamel", "typer", "rich", "click")
NOT_LIVE = ("replay_node", "live_replay")
NODES = sorted({path.stem for path in (ROOT / "stereo_depth_ros" / "nodes").glob("*.py")} - {"__init__", *NOT_LIVE})

IMPORT = f"""
import importlib, sys

class NotInApt:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {NOT_IN_APT!r}:
            raise ModuleNotFoundError(f"no module named {{name}}", name=name)

sys.meta_path.insert(0, NotInApt())
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def import_without(*modules: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", IMPORT, *modules], cwd=ROOT, capture_output=True, text=True)


def test_live_nodes_import_nothing_that_apt_does_not_have() -> None:
    assert len(NODES) > 10
    done = import_without(*(f"stereo_depth_ros.nodes.{node}" for node in NODES))
    assert done.returncode == 0, done.stderr


def test_the_blocked_packages_are_those_of_bags() -> None:
    """The oracle: what reads bags does not import here."""
    done = import_without("stereo_depth_ros.nodes.replay_node")
    assert done.returncode != 0 and "no module named rosbags" in done.stderr

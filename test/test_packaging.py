# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The repository is a ROS package: colcon builds it, and its executables run from the install space."""

from __future__ import annotations

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "stereo_depth_ros"
NODES = {
    *("rectify_node", "disparity_node", "point_cloud_node", "depth_node", "stereo_depth_node"),
    *("feature_node", "calibration_monitor", "health_node", "calibration_node", "replay_node"),
}
NOT_SOURCE = (".git", ".venv*", "build", "install", "log", "out", "__pycache__", "*.egg-info", ".*_cache")


@pytest.fixture(scope="module")
def install_space(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The prefix of the package in the install space of a colcon workspace that holds a copy of the repository."""
    colcon = Path(sys.executable).with_name("colcon")
    assert colcon.exists(), f"no colcon beside {sys.executable}: pip install -e '.[test]'"
    workspace = tmp_path_factory.mktemp("workspace")
    shutil.copytree(ROOT, workspace / "src" / "stereo_depth_ros", ignore=shutil.ignore_patterns(*NOT_SOURCE))
    done = subprocess.run([colcon, "build"], cwd=workspace, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return workspace / "install" / "stereo_depth_ros"


def in_sourced_shell(install_space: Path, command: str) -> subprocess.Popen[str]:
    """Starts a command as a user does who has sourced the workspace."""
    environment = {**os.environ, "ROS_DOMAIN_ID": "72", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return subprocess.Popen(
        ["bash", "-c", f". {install_space.parent}/setup.bash && exec {command}"],
        cwd=install_space,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def output_of(process: subprocess.Popen[str]) -> str:
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0, output
    return output


def test_share_is_complete(install_space: Path) -> None:
    share = install_space / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "stereo_depth_ros").is_file()
    for folder in ("launch", "config", "bags"):
        names = {path.name for path in (ROOT / folder).glob("*") if path.is_file()}
        assert {path.name for path in (share / "stereo_depth_ros" / folder).glob("*")} == names
        assert names
    assert (share / "stereo_depth_ros" / "package.xml").read_bytes() == (ROOT / "package.xml").read_bytes()


def test_executables_are_where_ros2_run_looks(install_space: Path) -> None:
    folder = install_space / "lib" / "stereo_depth_ros"
    assert {path.name for path in folder.iterdir()} == NODES | {"health_node", "stereo-depth"}
    assert all(os.access(path, os.X_OK) for path in folder.iterdir())


def test_every_module_is_installed(install_space: Path) -> None:
    (site,) = install_space.glob("lib/python3*/site-packages")
    installed = {path.relative_to(site) for path in site.glob("stereo_depth_ros/**/*.py")}
    assert installed == {path.relative_to(ROOT) for path in PACKAGE.rglob("*.py")}
    assert (site / "stereo_depth_ros" / "py.typed").is_file(), "type checkers ignore the annotations"


def test_installed_package_finds_its_profile(install_space: Path) -> None:
    code = "from stereo_depth_ros.nodes import transport; print(transport.__file__, transport.profile_path())"
    module, profile = output_of(in_sourced_shell(install_space, f'{sys.executable} -c "{code}"')).split()
    assert Path(module).is_relative_to(install_space)
    assert Path(profile) == install_space / "share" / "stereo_depth_ros" / "config" / "fastdds.xml"


def test_command_line_runs_from_the_install_space(install_space: Path) -> None:
    output = output_of(in_sourced_shell(install_space, f"{install_space}/lib/stereo_depth_ros/stereo-depth --help"))
    assert "replay" in output


@pytest.mark.graph
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_node_runs_from_the_install_space(install_space: Path, stop: signal.Signals) -> None:
    process = in_sourced_shell(install_space, f"{install_space}/lib/stereo_depth_ros/disparity_node")
    assert process.stdout
    watchdog = threading.Timer(60, process.kill)  # a node that says nothing
    watchdog.start()
    try:
        lines = []
        for line in process.stdout:
            lines.append(line)
            if "ready" in line:
                process.send_signal(stop)
                break
        rest, _ = process.communicate(timeout=30)
    finally:
        watchdog.cancel()
        process.kill()
    assert process.returncode == 0, "".join(lines) + rest
    assert "ready" in lines[-1]


def test_manifest_names_every_ros_package_that_is_imported() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    declared = {element.text for element in manifest if element.tag.endswith("depend")}
    trees = [ast.parse(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    modules = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    modules += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    ros = {name.split(".")[0] for name in modules if re.match(r"rclpy|\w+_(msgs|srvs|interfaces)\b", name)}
    assert ros
    assert ros <= declared

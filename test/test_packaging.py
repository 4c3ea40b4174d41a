# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The repository is a ROS package and a Python package: colcon and pip build it, and both results run elsewhere."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tarfile
import threading
import zipfile
from email import message_from_bytes
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "stereo_depth_ros"
VERSION = ElementTree.parse(ROOT / "package.xml").findtext("version")
NODES = {
    *("rectify_node", "disparity_node", "point_cloud_node", "depth_node", "stereo_depth_node"),
    *("feature_node", "view_node", "calibration_monitor", "health_node", "calibration_node", "replay_node"),
    *("structured_light_node", "light_stripe_node"),
}
NOT_SOURCE = (".git", ".venv*", "build", "install", "log", "out", "__pycache__", "*.egg-info", ".*_cache")


@pytest.fixture(scope="module")
def install_space(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The prefix of the package in the install space of a colcon workspace that holds a copy of the repository."""
    colcon = Path(sys.executable).with_name("colcon")
    assert colcon.exists(), f"no colcon beside {sys.executable}: pip install -e '.[test]'"
    workspace = tmp_path_factory.mktemp("workspace")
    copy_source(workspace / "src" / "stereo_depth_ros")
    done = subprocess.run([colcon, "build"], cwd=workspace, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    prefix = workspace / "install" / "stereo_depth_ros"
    (site,) = prefix.glob("lib/python3*/site-packages")
    for kernel in PACKAGE.rglob("*.nb[ic]"):  # the same code need not be compiled again
        (site / kernel.relative_to(ROOT)).parent.mkdir(exist_ok=True)
        shutil.copy(kernel, site / kernel.relative_to(ROOT))
    return prefix


def copy_source(target: Path) -> None:
    """Copies the repository without what is built in it."""
    shutil.copytree(ROOT, target, ignore=shutil.ignore_patterns(*NOT_SOURCE))


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


BUILD = """
import os, sys, tarfile
from pathlib import Path
from setuptools import build_meta
dist = Path(sys.argv[1])
sdist = dist / build_meta.build_sdist(str(dist))
with tarfile.open(sdist) as archive:
    archive.extractall(dist / "source")
os.chdir(dist / "source" / sdist.name.removesuffix(".tar.gz"))
build_meta.build_wheel(str(dist))
"""


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the source distribution, and the wheel that was built from it."""
    folder = tmp_path_factory.mktemp("dist")
    copy_source(folder / "repository")
    command = [sys.executable, "-c", BUILD, folder]
    done = subprocess.run(command, cwd=folder / "repository", capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}\nIs setuptools too old? pip install -e '.[test]'"
    return folder


def test_source_distribution_has_the_documents_and_no_tests(dist: Path) -> None:
    with tarfile.open(next(dist.glob("*.tar.gz"))) as archive:
        names = {Path(*Path(member.name).parts[1:]).as_posix() for member in archive if member.isfile()}
    documents = {path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").iterdir()}
    assert {"CHANGELOG.rst", "LICENSE", "README.md", "package.xml", *documents} <= names
    assert not {name.partition("/")[0] for name in names} & {"test", "tools", "benchmarks"}


def test_wheel_from_the_source_distribution_has_the_files_of_the_repository(dist: Path) -> None:
    sources = [*PACKAGE.rglob("*.py"), PACKAGE / "py.typed"]
    expected = {path.relative_to(ROOT).as_posix(): path.read_bytes() for path in sources}
    shared = [path for folder in ("launch", "config", "bags") for path in (ROOT / folder).glob("*") if path.is_file()]
    for path in (*shared, ROOT / "package.xml"):
        expected[f"DATA/share/stereo_depth_ros/{path.relative_to(ROOT).as_posix()}"] = path.read_bytes()
    expected["DATA/share/ament_index/resource_index/packages/stereo_depth_ros"] = b""
    with zipfile.ZipFile(next(dist.glob("*.whl"))) as archive:
        names = {name.replace(f"stereo_depth_ros-{VERSION}.data/data", "DATA"): name for name in archive.namelist()}
        info = {name for name in names if ".dist-info/" in name}
        assert {short: archive.read(names[short]) for short in set(names) - info} == expected
        assert any(name.endswith("/LICENSE") for name in info)


def test_wheel_describes_the_package(dist: Path) -> None:
    with zipfile.ZipFile(next(dist.glob("*.whl"))) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = message_from_bytes(archive.read(name))
    assert metadata["License"] == "Apache-2.0"
    assert metadata["Maintainer-email"].endswith("@example.org")
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata.get_payload(decode=True).decode().strip() == (ROOT / "README.md").read_text("utf-8").strip()
    pythons = {
        line for line in metadata.get_all("Classifier") if line.startswith("Programming Language :: Python :: 3.")
    }
    assert pythons == {f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 14)}


INSTALLED = """
import sys
from stereo_depth_ros.cli import main
from stereo_depth_ros.files.installed_files import installed_files
print(main.__file__, *installed_files("bags/*.mcap"))
main.main()
"""


def test_wheel_runs_where_it_is_unpacked(dist: Path, tmp_path: Path) -> None:
    site = tmp_path / "lib" / "site-packages"
    with zipfile.ZipFile(next(dist.glob("*.whl"))) as archive:
        archive.extractall(site)
    (data,) = site.glob("*.data/data")
    (data / "share").rename(tmp_path / "share")
    bag = tmp_path / "share" / "stereo_depth_ros" / "bags" / "synthetic_room.mcap"
    for arguments, answer in (("--version", f"stereo_depth_ros {VERSION}"), (f"info {bag}", "/left/image_raw")):
        done = subprocess.run(
            [sys.executable, "-c", INSTALLED, *arguments.split()],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(site)},
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stderr
        places, _, output = done.stdout.partition("\n")
        assert places == f"{site}/stereo_depth_ros/cli/main.py {bag}"
        assert answer in output


def test_every_source_file_states_copyright_and_license() -> None:
    skipped = [path for pattern in NOT_SOURCE for path in ROOT.glob(pattern)]
    sources = [path for path in ROOT.rglob("*.py") if not any(path.is_relative_to(folder) for folder in skipped)]
    assert len(sources) > 300
    for path in (*sources, ROOT / "Makefile", ROOT / ".ci" / "run"):
        head = path.read_text("utf-8")[:300]
        assert "SPDX-FileCopyrightText: The stereo_depth_ros authors\n" in head, path
        assert "SPDX-License-Identifier: Apache-2.0\n" in head, path

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is imported is declared and what is declared is imported: setup.py for pip, package.xml for ROS."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
import setuptools
from architecture import PACKAGE, read_imports
from catkin_pkg.package import parse_package

ROOT = Path(__file__).resolve().parents[1]
ROS = re.compile(r"rclpy|launch(_ros)?|\w+_(msgs|srvs|interfaces)")
# modules whose distribution has another name
DISTRIBUTIONS = {
    "catkin_pkg": "catkin-pkg",
    "cv2": "opencv-python-headless",
    "maxflow": "PyMaxflow",
    "ruamel": "ruamel.yaml",
    "xdist": "pytest-xdist",
    "yaml": "PyYAML",
}
# run as programs
PROGRAMS = {"colcon-common-extensions", "mypy", "ruff"}
OWN_ENVIRONMENT = {"torch"}  # of the export of a network, see benchmarks/export_psmnet.py
# The key of each requirement in rosdep's python.yaml; empty where it has none for Ubuntu, only one that installs with
# pip (which a released package must not use), or one of a version that is too old: these are installed with pip.
ROSDEP_KEYS = {
    "lz4": "",
    "mcap": "",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "opencv-python-headless": "python3-opencv",
    "rich": "",  # python3-rich, 13.7 in Ubuntu 24.04
    "rosbags": "",  # python3-rosbags-pip
    "ruamel.yaml": "python3-ruamel.yaml",
    "shellingham": "",
    "typer": "",  # python3-typer, 0.9 in Ubuntu 24.04
    "zstandard": "",
}


@pytest.fixture(scope="module")
def setup() -> SimpleNamespace:
    """The arguments of setup.py."""
    found = SimpleNamespace()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(setuptools, "setup", lambda **arguments: vars(found).update(arguments))
        runpy.run_path("setup.py")
    return found


@pytest.fixture(scope="module")
def imported() -> set[str]:
    """First names of the modules that the package imports."""
    return {found.imported.split(".")[0] for found in read_imports(ROOT)}


def names(requirements: Iterable[str]) -> set[str]:
    """Names of distributions, without versions."""
    return {re.split(r"[<>=!~; ]", requirement)[0] for requirement in requirements}


def optional(setup: SimpleNamespace) -> set[str]:
    """Requirements of the extras with which the package does more."""
    return {requirement for extra in ("graph_cut", "onnx", "las") for requirement in setup.extras_require[extra]}


def imports_of(folders: Iterable[str]) -> set[str]:
    """First names of the modules that the Python files of these folders import."""
    trees = [ast.parse(path.read_text("utf-8")) for folder in folders for path in (ROOT / folder).rglob("*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    found = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    found += [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    found += [
        argument.value
        for node in nodes
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("importorskip")
        for argument in node.args
        if isinstance(argument, ast.Constant)
    ]
    return {name.split(".")[0] for name in found}


def third_party(modules: Iterable[str]) -> set[str]:
    """The distributions of the modules that are neither Python's, ROS's nor the repository's own."""
    own = {PACKAGE, *(path.stem for folder in ("test", "tools", "benchmarks") for path in (ROOT / folder).glob("*.py"))}
    others = {name for name in modules if name not in sys.stdlib_module_names | own and not ROS.fullmatch(name)}
    return {DISTRIBUTIONS.get(name, name) for name in others}


def test_every_import_of_the_package_is_a_requirement_and_every_requirement_is_imported(
    setup: SimpleNamespace, imported: set[str]
) -> None:
    used = third_party(imported)
    declared = names(setup.install_requires) | names(optional(setup))
    assert used - declared == set(), "imported, but not declared in setup.py"
    assert declared - used == set(), "declared in setup.py, but not imported"


def test_the_extras_of_development_are_what_tests_and_tools_use(setup: SimpleNamespace) -> None:
    package = names(setup.install_requires)
    declared = names(setup.extras_require["test"]) | names(setup.extras_require["lint"])
    used = third_party(imports_of(("test", "tools", "benchmarks", ".ci"))) | PROGRAMS
    used -= OWN_ENVIRONMENT
    assert used - package - declared == set(), "imported by tests or tools, but neither in [test] nor in [lint]"
    assert declared - used - names(optional(setup)) == set(), "declared, but not used"


def test_tests_cover_every_extra(setup: SimpleNamespace) -> None:
    assert optional(setup) <= set(setup.extras_require["test"])


def test_every_requirement_has_a_floor(setup: SimpleNamespace) -> None:
    requirements = [*setup.install_requires, *chain.from_iterable(setup.extras_require.values())]
    assert not [text for text in requirements if not re.fullmatch(r"[\w.-]+>=\d+(\.\d+)+", text)]


def test_extras_of_ros_are_the_same_packages_of_each_release(setup: SimpleNamespace) -> None:
    jazzy, kilted = (names(setup.extras_require[extra]) for extra in ("ros", "ros-kilted"))
    assert {name.replace("jazzy", "kilted") for name in jazzy} == kilted
    assert len(kilted) == 3


def manifest() -> dict[str, str]:
    """The dependencies in package.xml: kind by name."""
    elements = [item for item in ElementTree.parse(ROOT / "package.xml").getroot() if item.tag.endswith("depend")]
    assert len({item.text for item in elements}) == len(elements), "named twice"
    return {item.text or "": item.tag for item in elements}


def test_manifest_names_the_rosdep_key_of_every_requirement(setup: SimpleNamespace) -> None:
    assert set(ROSDEP_KEYS) == names(setup.install_requires)
    keys = {name for name, kind in manifest().items() if name.startswith("python3-") and kind == "exec_depend"}
    assert keys == set(ROSDEP_KEYS.values()) - {""}


def test_manifest_names_the_ros_packages_that_are_used_and_no_others(imported: set[str]) -> None:
    text = "".join(path.read_text("utf-8") for path in (ROOT / PACKAGE / "nodes").rglob("*.py"))
    types = set(re.findall(r'"(\w+)/(?:msg|srv)/\w+"', text))  # imported by the name of the message type
    ros = {name for name in imported | imports_of(("launch",)) if ROS.fullmatch(name)} | types
    assert {"rclpy", "launch_ros", "sensor_msgs"} <= ros
    assert "std_srvs" in types
    run = {name for name, kind in manifest().items() if kind == "exec_depend" and not name.startswith("python3-")}
    assert run - {"ros2launch"} == ros  # ros2launch runs the launch file


def test_manifest_is_valid() -> None:
    package = parse_package(ROOT / "package.xml")
    warnings: list[str] = []
    package.validate(warnings=warnings)
    assert warnings == []

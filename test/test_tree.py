# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The core runs where ROS is not installed, and imports point downward."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "stereo_depth_ros"
ROS_NAMES = (
    r"(rclpy|rpyutils|rosidl_\w+|\w+_msgs|\w+_srvs|\w+_interfaces|ament_\w+|launch\w*|cv_bridge|message_filters)"
)

IMPORT_WITHOUT_ROS = f"""
import importlib, re, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        if re.fullmatch({ROS_NAMES!r}, name.split(".")[0]):
            raise ModuleNotFoundError(f"no module named {{name}}", name=name)

sys.meta_path.insert(0, NoRos())
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
CORE = {name: path for name, path in MODULES.items() if not name.startswith("stereo_depth_ros.nodes")}
CLI = {name for name in MODULES if name.startswith("stereo_depth_ros.cli")}


def imports(name: str, at_module_level: bool) -> Iterator[str]:
    """Modules of the package that a module imports, anywhere or outside functions only."""
    pending: list[ast.AST] = [ast.parse(MODULES[name].read_text("utf-8"))]
    while pending:
        node = pending.pop()
        if at_module_level and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        pending += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import, line {node.lineno}: name the module in full"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in MODULES else node.module or ""


def import_without_ros(*names: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", IMPORT_WITHOUT_ROS, *names]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


def test_core_imports_without_ros() -> None:
    assert {"stereo_depth_ros.config", "stereo_depth_ros.core.types"} <= CORE.keys()
    done = import_without_ros(*CORE)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["rclpy", "sensor_msgs.msg", "std_srvs.srv", "builtin_interfaces.msg"])
def test_the_block_blocks(name: str) -> None:
    done = import_without_ros(name)
    assert "ModuleNotFoundError" in done.stderr
    assert done.returncode == 1


def test_core_does_not_import_nodes() -> None:
    for name in CORE:
        nodes = [found for found in imports(name, name in CLI) if found.startswith("stereo_depth_ros.nodes")]
        assert not nodes, f"{name} imports {nodes}: the core knows nothing of the nodes"


def test_nothing_imports_the_command_line() -> None:
    above = [name for name in MODULES.keys() - CLI if CLI & set(imports(name, at_module_level=False))]
    assert not above, f"{above} import the command line, which is the top"


def test_imports_have_no_cycle() -> None:
    graph = {name: {found for found in imports(name, True) if found in MODULES} for name in MODULES}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"imports go in a circle: {' -> '.join(error.args[1])}")

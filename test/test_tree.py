# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The architecture: imports point downward without a cycle, ROS, I/O and printing stay where they belong."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path

import pytest
from architecture import LIBRARIES, ORDER, PACKAGE, Import, modules, part_of, parts, read_imports

ROOT = Path(__file__).resolve().parents[1]
ROS_NAMES = (
    r"(rclpy|rpyutils|rosidl_\w+|\w+_msgs|\w+_srvs|\w+_interfaces|ament_\w+|launch\w*|cv_bridge|message_filters)"
)
NO_IO = ("core", "stages", "matching")
IO_PARTS = ("files", "bags", "datasets", "messages")
IO_LIBRARIES = ("rosbags", "mcap", "zstandard", "lz4", "typer", "rich")
FILES = ("os", "io", "pathlib", "shutil", "tempfile", "glob")  # modules of files and folders
# Text files, such as those of StereoRig.from_yaml, the cache of compiled kernels, the file of a network.
MAY_USE_FILES = (
    "core/text_files.py",
    "core/rig.py",
    "core/camera_yaml.py",
    "core/kernels.py",
    "core/bands.py",
    "matching/networks/network.py",
)
EXITS = ("print", "exit", "quit", "sys.exit", "os._exit", "typer.Exit", "typer.Abort", "SystemExit")

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


def report(found: Import, rule: str) -> str:
    return f"{found.file}:{found.line}: {found.importer} imports {found.imported}: {rule}"


def undeclared_parts(root: Path) -> list[str]:
    """Packages and root modules that the order lacks, and names in the order without a package."""
    there = parts(root)
    extra = [f"{PACKAGE}/{part}: not declared in ORDER of tools/architecture.py" for part in there - set(ORDER)]
    return sorted(extra + [f"{part}: declared in ORDER, but not in {PACKAGE}/" for part in set(ORDER) - there])


def upward_imports(root: Path) -> list[str]:
    """Imports of something higher, of the root package, or relative ones."""
    lines = []
    for found in read_imports(root):
        importer, imported = part_of(found.importer), part_of(found.imported)
        if found.imported.startswith("."):
            lines.append(report(found, "name the module in full"))
        elif found.imported == PACKAGE and importer:
            lines.append(report(found, "name the module, the root package is for users"))
        elif {importer, imported} <= set(ORDER) and ORDER.index(imported) > ORDER.index(importer):
            lines.append(report(found, f"{imported} stands above {importer}"))
    return lines


def circular_imports(root: Path) -> list[str]:
    """One cycle of the modules, and one of the subpackages and modules in each package, if there are any."""
    known = modules(root)
    imports = [found for found in read_imports(root) if found.imported in known]
    lines = circle({(found.importer, found.imported): found for found in imports})
    for name, path in known.items():
        if path.name == "__init__.py":
            inside = [i for i in imports if all(f"{end}.".startswith(f"{name}.") for end in (i.importer, i.imported))]
            lines += circle({(child(name, i.importer), child(name, i.imported)): i for i in inside})
    return sorted(set(lines))


def child(package: str, module: str) -> str:
    """What of ``package`` a module of it belongs to: a subpackage, a module, or the package itself."""
    return ".".join(module.split(".")[: package.count(".") + 2])


def circle(edges: dict[tuple[str, str], Import]) -> list[str]:
    graph: dict[str, set[str]] = {}
    for importer, imported in edges:
        if importer != imported:
            graph.setdefault(importer, set()).add(imported)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        names = error.args[1][::-1]
        return [report(edges[edge], f"cycle {' -> '.join(names)}") for edge in pairwise(names)]
    return []


def ros_outside_nodes(root: Path) -> list[str]:
    found = [i for i in read_imports(root) if re.fullmatch(ROS_NAMES, i.imported.split(".")[0])]
    return [report(i, "only nodes import ROS") for i in found if part_of(i.importer) != "nodes"]


def misplaced_libraries(root: Path) -> list[str]:
    """Imports of a library by a package that it is not declared for."""
    lines = []
    for found in read_imports(root):
        users = LIBRARIES.get(found.imported.split(".")[0])
        if users is not None and part_of(found.importer) not in users:
            lines.append(report(found, f"only {', '.join(users)} may"))
    return lines


def io_in_the_library(root: Path) -> list[str]:
    """Imports of files, bags, messages and terminals in the packages that compute."""
    lines = []
    for found in read_imports(root):
        library = found.imported.split(".")[0]
        files = library in FILES and not found.file.endswith(MAY_USE_FILES)
        if part_of(found.importer) in NO_IO and (
            part_of(found.imported) in IO_PARTS or library in IO_LIBRARIES or files
        ):
            lines.append(report(found, "no I/O here"))
    return lines


def prints_and_exits(root: Path) -> list[str]:
    """Prints and exits outside cli; ``raise SystemExit(main())`` of a node's own program is allowed."""
    return [
        f"{path.relative_to(root).as_posix()}:{line}: {text}: only cli prints and exits"
        for name, path in modules(root).items()
        if part_of(name) != "cli"
        for line, text in exits(ast.parse(path.read_text("utf-8")), program=part_of(name) == "nodes")
    ]


def exits(tree: ast.Module, program: bool) -> Iterator[tuple[int, str]]:
    allowed: set[ast.AST] = set()
    for statement in tree.body if program else []:
        if ast.unparse(statement) == "if __name__ == '__main__':\n    raise SystemExit(main())":
            allowed |= set(ast.walk(statement))
    for node in ast.walk(tree):
        if node in allowed:
            continue
        if isinstance(node, ast.Call) and (
            ast.unparse(node.func) in EXITS or ast.unparse(node.func).endswith(".print")
        ):
            yield node.lineno, f"{ast.unparse(node.func)}()"
        elif isinstance(node, ast.Raise) and node.exc is not None and ast.unparse(node.exc) in EXITS:
            yield node.lineno, f"raise {ast.unparse(node.exc)}"
        elif isinstance(node, ast.ImportFrom) and node.module in ("sys", "os", "typer"):
            names = [alias.name for alias in node.names if f"{node.module}.{alias.name}" in EXITS]
            yield from ((node.lineno, f"from {node.module} import {name}") for name in names)


RULES = (
    undeclared_parts,
    upward_imports,
    circular_imports,
    ros_outside_nodes,
    misplaced_libraries,
    io_in_the_library,
    prints_and_exits,
)


@pytest.mark.parametrize("rule", RULES)
def test_the_tree_keeps_the_rule(rule: Callable[[Path], list[str]]) -> None:
    found = rule(ROOT)
    assert not found, "\n".join(found)


def test_the_tree_is_read() -> None:
    """The rules would also pass on imports that are not found."""
    edges = {(part_of(found.importer), part_of(found.imported)) for found in read_imports(ROOT)}
    assert {("config", "core"), ("stages", "matching"), ("nodes", "outputs"), ("cli", "nodes")} <= edges
    assert Import(
        f"{PACKAGE}/bags/inflate.py", *line_of("bags/inflate.py", "import zstandard"), "zstandard"
    ) in read_imports(ROOT)


def line_of(file: str, text: str) -> tuple[int, str]:
    """Line of a statement and name of the module of a file."""
    lines = (ROOT / PACKAGE / file).read_text("utf-8").splitlines()
    return next(
        n for n, line in enumerate(lines, 1) if line.strip() == text
    ), f"{PACKAGE}.{file[:-3].replace('/', '.')}"


def test_declared_libraries_are_those_imported() -> None:
    """A line of the declaration that is not true any more is removed."""
    used = {(part_of(found.importer), found.imported.split(".")[0]) for found in read_imports(ROOT)}
    assert not [(part, name) for name, users in LIBRARIES.items() for part in users if (part, name) not in used]
    assert not {user for name in IO_LIBRARIES for user in LIBRARIES[name]} & set(NO_IO)


def tree(root: Path, files: dict[str, str]) -> Path:
    """A source tree with all declared packages, and these files in it."""
    for part in ORDER:
        files.setdefault(f"{part}.py" if part in ("pipeline", "outputs") else f"{part}/__init__.py", "")
    for file, text in {"__init__.py": "", **files}.items():
        path = root / PACKAGE / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def test_an_empty_tree_keeps_all_rules(tmp_path: Path) -> None:
    assert [line for rule in RULES for line in rule(tree(tmp_path, {}))] == []


@pytest.mark.parametrize(
    ("rule", "files", "expected"),
    [
        (undeclared_parts, {"extra/__init__.py": ""}, ["stereo_depth_ros/extra: not declared"]),
        (undeclared_parts, {"extra.py": ""}, ["stereo_depth_ros/extra: not declared"]),
        (
            upward_imports,
            {"core/a.py": "x = 1\ndef f():\n    from stereo_depth_ros.config import y\n"},
            ["stereo_depth_ros/core/a.py:3: stereo_depth_ros.core.a imports stereo_depth_ros.config: config stands"],
        ),
        (
            upward_imports,
            {"stages/a.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import stereo_depth_ros.cli.b\n"},
            ["stereo_depth_ros/stages/a.py:3: stereo_depth_ros.stages.a imports stereo_depth_ros.cli.b: cli stands"],
        ),
        (
            upward_imports,
            {"stages/a.py": "from stereo_depth_ros import pipeline\n"},
            ["stereo_depth_ros/stages/a.py:1: stereo_depth_ros.stages.a imports stereo_depth_ros.pipeline: pipeline"],
        ),
        (
            upward_imports,
            {"core/a.py": "import importlib\nimportlib.import_module('stereo_depth_ros.bags')\n"},
            ["stereo_depth_ros/core/a.py:2: stereo_depth_ros.core.a imports stereo_depth_ros.bags: bags stands above"],
        ),
        (
            upward_imports,
            {"core/a.py": "from . import b\nfrom stereo_depth_ros import StereoRig\n", "core/b.py": ""},
            [
                "stereo_depth_ros/core/a.py:1: stereo_depth_ros.core.a imports .: name the module in full",
                "stereo_depth_ros/core/a.py:2: stereo_depth_ros.core.a imports stereo_depth_ros: name the module, the",
            ],
        ),
        (
            circular_imports,
            {
                "core/a.py": "import stereo_depth_ros.core.b\n",
                "core/b.py": "\ndef f():\n    import stereo_depth_ros.core.a\n",
            },
            [
                "stereo_depth_ros/core/a.py:1: stereo_depth_ros.core.a imports stereo_depth_ros.core.b: cycle ",
                "stereo_depth_ros/core/b.py:3: stereo_depth_ros.core.b imports stereo_depth_ros.core.a: cycle ",
            ],
        ),
        (
            circular_imports,  # of subpackages, though not of modules
            {
                "matching/sgm/__init__.py": "",
                "matching/sgm/a.py": "from stereo_depth_ros.matching.window import d\n",
                "matching/sgm/b.py": "",
                "matching/window/__init__.py": "",
                "matching/window/c.py": "from stereo_depth_ros.matching.sgm.b import x\n",
                "matching/window/d.py": "",
            },
            [
                "stereo_depth_ros/matching/sgm/a.py:1: stereo_depth_ros.matching.sgm.a imports stereo_depth_ros.m",
                "stereo_depth_ros/matching/window/c.py:1: stereo_depth_ros.matching.window.c imports stereo_depth_ros",
            ],
        ),
        (
            ros_outside_nodes,
            {"messages/a.py": "import numpy\nfrom sensor_msgs.msg import Image\n", "nodes/b.py": "import rclpy\n"},
            ["stereo_depth_ros/messages/a.py:2: stereo_depth_ros.messages.a imports sensor_msgs.msg: only nodes"],
        ),
        (
            misplaced_libraries,
            {"plots/a.py": "from ruamel.yaml import YAML\n", "core/b.py": "from ruamel.yaml import YAML\n"},
            ["stereo_depth_ros/plots/a.py:1: stereo_depth_ros.plots.a imports ruamel.yaml: only core may"],
        ),
        (
            io_in_the_library,
            {"stages/a.py": "import zstandard\nimport stereo_depth_ros.bags\n", "bags/b.py": "import zstandard\n"},
            [
                "stereo_depth_ros/stages/a.py:1: stereo_depth_ros.stages.a imports zstandard: no I/O here",
                "stereo_depth_ros/stages/a.py:2: stereo_depth_ros.stages.a imports stereo_depth_ros.bags: no I/O here",
            ],
        ),
        (
            prints_and_exits,
            {
                "core/a.py": "from sys import exit\nprint(1)\nraise SystemExit\n",
                "core/b.py": "if __name__ == '__main__':\n    raise SystemExit(main())\n",
                "nodes/c.py": "import sys\ndef f():\n    sys.exit(1)\n"
                "if __name__ == '__main__':\n    raise SystemExit(main())\n",
                "cli/d.py": "print(1)\n",
            },
            [
                "stereo_depth_ros/core/a.py:1: from sys import exit: only cli prints and exits",
                "stereo_depth_ros/core/a.py:2: print(): only cli prints and exits",
                "stereo_depth_ros/core/a.py:3: raise SystemExit: only cli prints and exits",
                "stereo_depth_ros/core/b.py:2: SystemExit(): only cli prints and exits",
                "stereo_depth_ros/nodes/c.py:3: sys.exit(): only cli prints and exits",
            ],
        ),
    ],
)
def test_the_rule_finds_it(
    tmp_path: Path, rule: Callable[[Path], list[str]], files: dict[str, str], expected: list[str]
) -> None:
    found = sorted(rule(tree(tmp_path, files)))
    assert len(found) == len(expected), found
    assert all(line.startswith(start) for line, start in zip(found, expected, strict=True)), found


def test_a_declared_package_that_is_gone(tmp_path: Path) -> None:
    (tree(tmp_path, {}) / PACKAGE / "outputs.py").unlink()
    assert undeclared_parts(tmp_path) == ["outputs: declared in ORDER, but not in stereo_depth_ros/"]


def import_without_ros(*names: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", IMPORT_WITHOUT_ROS, *names]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


def test_all_but_the_nodes_import_without_ros() -> None:
    names = [name for name in modules(ROOT) if part_of(name) != "nodes"]
    assert {"stereo_depth_ros.config", "stereo_depth_ros.core.types", "stereo_depth_ros.cli.main"} <= set(names)
    done = import_without_ros(*names)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["rclpy", "sensor_msgs.msg", "std_srvs.srv", "builtin_interfaces.msg"])
def test_the_block_blocks(name: str) -> None:
    done = import_without_ros(name)
    assert "ModuleNotFoundError" in done.stderr
    assert done.returncode == 1


def test_the_command_line_imports_nodes_inside_functions_only() -> None:
    """So that it also runs without ROS."""
    for name, path in modules(ROOT).items():
        if part_of(name) == "cli":
            outside = [
                s for s in ast.parse(path.read_text("utf-8")).body if isinstance(s, (ast.Import, ast.ImportFrom))
            ]
            assert "stereo_depth_ros.nodes" not in "\n".join(map(ast.unparse, outside)), f"{name}: needs ROS"

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The declared order of the packages, and what the source says: modules, their roles and their imports."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

__all__ = [
    "LIBRARIES",
    "ORDER",
    "PACKAGE",
    "Import",
    "modules",
    "part_of",
    "parts",
    "read_imports",
    "render_files",
    "render_tree",
    "role",
]

PACKAGE = "stereo_depth_ros"

# Packages and root modules, lowest first: each imports only what stands before it.
ORDER = (
    "core",
    "files",
    "camera_files",
    "config",
    "ranging",
    "matching",
    "stages",
    "pipeline",
    "messages",
    "outputs",
    "bags",
    "datasets",
    "synthetic",
    "geometry",
    "calibration",
    "active",
    "surfaces",
    "evaluation",
    "plots",
    "views",
    "diagnosis",
    "offline",
    "replay",
    "nodes",
    "cli",
)

# Libraries that only these packages import; ROS is imported in nodes only.
LIBRARIES: Mapping[str, tuple[str, ...]] = {
    "numba": ("core", "matching"),
    "maxflow": ("matching",),
    "onnxruntime": ("matching",),
    "ruamel": ("core",),
    "laspy": ("files",),
    "lazrs": ("files",),
    "lz4": ("bags",),
    "mcap": ("bags",),
    "rosbags": ("bags",),
    "zstandard": ("bags",),
    "rich": ("cli",),
    "typer": ("cli",),
}


class Import(NamedTuple):
    """One import statement, wherever in a file it stands.

    Attributes:
        file: path relative to the source tree.
        line: line number.
        importer: full name of the module that imports.
        imported: full name of the module that is imported; a relative import keeps its dots.
    """

    file: str
    line: int
    importer: str
    imported: str


def modules(root: Path) -> dict[str, Path]:
    """All modules of the package below the source tree ``root``: path by full name, packages included."""
    return {_module_name(path.relative_to(root)): path for path in sorted((root / PACKAGE).rglob("*.py"))}


def parts(root: Path) -> set[str]:
    """Names of the packages and root modules."""
    return {part for name in modules(root) if (part := part_of(name))}


def part_of(module: str) -> str:
    """The package or root module that a module is in; empty for the root package and for other libraries."""
    first, _, rest = module.partition(".")
    return rest.partition(".")[0] if first == PACKAGE else ""


def role(path: Path) -> str:
    """The first line of a module's docstring, empty where it has none."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]


@functools.cache
def read_imports(root: Path) -> tuple[Import, ...]:
    """Every import in the package, also inside functions, under TYPE_CHECKING, and by ``import_module("name")``."""
    known = modules(root)
    return tuple(
        Import(path.relative_to(root).as_posix(), line, name, imported)
        for name, path in known.items()
        for line, imported in _imports_of(ast.parse(path.read_text(encoding="utf-8")), known)
    )


def render_tree(root: Path) -> str:
    """The Markdown table of packages and root modules in the declared order, with their roles."""
    rows = []
    for name in ORDER:
        folder = root / PACKAGE / name
        path, shown = (
            (folder / "__init__.py", f"{name}/") if folder.is_dir() else (folder.with_suffix(".py"), f"{name}.py")
        )
        rows.append(f"| `{shown}` | {role(path)} |")
    return "\n".join(["| package or module | role |", "| --- | --- |", *rows])


def render_files(root: Path) -> str:
    """The Markdown table of all modules: path and the first line of the docstring."""
    roles = {path.relative_to(root).as_posix(): role(path) for path in modules(root).values()}
    rows = [f"| `{file}` | {text} |" for file, text in roles.items() if text]
    return "\n".join(["| file | role |", "| --- | --- |", *rows])


def _module_name(path: Path) -> str:
    names = path.with_suffix("").parts
    return ".".join(names[:-1] if names[-1] == "__init__" else names)


def _imports_of(tree: ast.AST, known: Mapping[str, Path]) -> Iterator[tuple[int, str]]:
    """Line and name of what is imported: of ``from a import b`` it is a.b where that is a module, else a."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = "." * node.level + (node.module or "")
            inner = [f"{source}.{alias.name}" for alias in node.names]
            yield from sorted({(node.lineno, name if name in known else source) for name in inner})
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module") and node.args:
            name = node.args[0]
            if isinstance(name, ast.Constant) and isinstance(name.value, str):
                yield node.lineno, name.value

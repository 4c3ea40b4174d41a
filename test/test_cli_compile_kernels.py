# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth compile-kernels`: afterwards the code of every kernel is on disk. It runs first, beside the graph."""

from __future__ import annotations

import re
from pathlib import Path

from command_line import CommandLine

from stereo_depth_ros.cli.compile_kernels import PACKAGES
from stereo_depth_ros.core import kernels

ROOT = Path(__file__).resolve().parents[1]


def test_the_kernels_of_every_package_are_compiled() -> None:
    """Others would be compiled when they are first used."""
    with_kernels = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "stereo_depth_ros").rglob("*.py")
        if re.search(r"^@compiled\(", path.read_text("utf-8"), re.MULTILINE)
    }
    assert len(with_kernels) > 30
    packages = tuple(f"{package.__name__.replace('.', '/')}/" for package in PACKAGES)
    missing = {path for path in with_kernels if not path.startswith(packages)}
    assert not missing, f"{missing}: add the package to PACKAGES of cli/compile_kernels.py"


def test_collecting_the_tests_calls_none(called_by_collection: list[str]) -> None:
    """It would compile them all, beside nothing else: draw or match in a fixture, not in the module of a test."""
    assert called_by_collection == []


def test_none_is_left_to_compile(command_line: CommandLine) -> None:
    code, out, err = command_line("compile-kernels")()
    assert (code, out) == (0, "")
    assert err.endswith("all kernels are compiled\n")
    assert not kernels._pending

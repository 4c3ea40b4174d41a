# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures for all tests."""

from __future__ import annotations

import ast
import functools
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine, Run

from stereo_depth_ros.cli import main as cli
from stereo_depth_ros.core import kernels

# Compiles the kernels for all processes, half of them beside the first test of the graph, which waits for them.
KERNELS = "test_cli_compile_kernels.py"
# Long and without kernels: they run meanwhile.
FIRST = (KERNELS, "test_lint.py", "test_stereo_calibration.py", "test_collected.py", "test_boards.py")
LOWERED = pytest.StashKey[bool]()
CALLED = pytest.StashKey[list[str]]()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tests of the graph first: with several processes they take longest."""
    order = {name: number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: (item.get_closest_marker("graph") is None, order.get(item.path.name, len(order))))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Which kernels were called by modules of tests: every process then compiles before its first test."""
    modules = [module for name, module in sys.modules.items() if name.startswith("stereo_depth_ros.")]
    found = {value for module in modules for value in vars(module).values() if isinstance(value, kernels.Kernel)}
    session.config.stash[CALLED] = sorted(kernel.name for kernel in found - set(kernels._pending))


@pytest.fixture(scope="session")
def called_by_collection(pytestconfig: pytest.Config) -> list[str]:
    """Names of the kernels that were called while the tests were collected."""
    return pytestconfig.stash[CALLED]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Of several processes, the one of the graph, which mostly waits, has the cores when it needs them."""
    lower = item.get_closest_marker("graph") is None and item.path.name != KERNELS
    if "PYTEST_XDIST_WORKER" in os.environ and lower and LOWERED not in item.config.stash:
        item.config.stash[LOWERED] = True
        os.nice(5)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Of several processes, one runs all tests of the graph, so that no two graphs compete; files stay together."""
    from xdist.scheduler import LoadScopeScheduling

    config.option.loadscopereorder = False  # the order of the items

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file, _, test = nodeid.partition("::")
            of_graph = _tests_of_graph(config.rootpath / file)
            return "graph" if of_graph is None or test.partition("[")[0] in of_graph else file

    return Scheduling(config, log)


@functools.cache
def _tests_of_graph(path: Path) -> frozenset[str] | None:
    """Names of the tests of a file that are marked graph; None where the file or the parameters of a test are.

    The markers themselves are known only in the processes that run the tests.
    """
    marked = set()
    for node in ast.parse(path.read_text("utf-8")).body:
        if any(isinstance(n, ast.Attribute) and ast.unparse(n) == "pytest.mark.graph" for n in ast.walk(node)):
            if not (isinstance(node, ast.FunctionDef) and node.name.startswith("test_")):
                return None
            marked.add(node.name)
    return frozenset(marked)


@pytest.fixture(scope="session")
def stereo_data() -> Path:
    """The folder of real pairs and sequences; tests that need it are skipped where it is not."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STEREO_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}: set STEREO_DATA")
    return folder


@pytest.fixture
def command_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[CommandLine]:
    """Runs `stereo-depth` in this process; see :mod:`command_line`."""
    before = signal.getsignal(signal.SIGTERM)

    def of_command(*command: str, columns: int | None = None) -> Run:
        if columns is not None:
            monkeypatch.setenv("COLUMNS", str(columns))

        def run(*arguments: object) -> tuple[int, str, str]:
            monkeypatch.setattr("sys.argv", ["stereo-depth", *command, *map(str, arguments)])
            with pytest.raises(SystemExit) as ended:
                cli.main()
            out, err = capsys.readouterr()
            return int(ended.value.code or 0), out, err

        return run

    yield of_command
    signal.signal(signal.SIGTERM, before)

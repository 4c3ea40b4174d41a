# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures for all tests."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine, Run

from stereo_depth_ros.cli import main as cli


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of several processes, one runs all tests of the graph, so that no two graphs compete; files stay together."""
    for item in items:
        graph = item.get_closest_marker("graph") is not None
        item.add_marker(pytest.mark.xdist_group("graph" if graph else item.path.name))
    items.sort(key=lambda item: item.get_closest_marker("graph") is None)  # the longest group first


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

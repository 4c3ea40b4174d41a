# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A pytest plugin: the run fails when tests that should have run did not (``pytest -p completeness``).

A file with tests must have been collected, tests of the graph must have run, and so must tests on real data where the
data is, and tests of a trained network where its file is named.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

__all__ = ["Completeness", "pytest_configure"]


class Completeness:
    """Watches a run and says at its end what is missing from it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.has_data = Path(os.environ.get("STEREO_DATA", root.parent / "shared" / "data")).is_dir()
        self.files: set[Path] = set()
        self.markers: dict[str, set[str]] = {}
        self.ran: set[str] = set()
        self.graph_processes: set[str] = set()
        self.skipped: set[str] = set()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Notes what ran and what was skipped, in any process; an expected failure ran."""
        self.files.add(self.root / report.nodeid.partition("::")[0])
        self.markers[report.nodeid] = set(report.keywords) & {"graph", "network", "real_data"}
        if report.skipped and not hasattr(report, "wasxfail"):
            self.skipped.add(report.nodeid)
        elif report.when == "call":
            self.ran.add(report.nodeid)
            if "graph" in self.markers[report.nodeid]:
                self.graph_processes.add(getattr(report, "worker_id", ""))

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fails a run that passed without being complete."""
        if self.missing() and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Prints what is missing, before pytest's closing line."""
        for line in self.missing():
            terminalreporter.write_line(f"INCOMPLETE {line}", red=True)

    def missing(self) -> list[str]:
        """One line for each thing that should have run and did not."""
        lines = [f"{path.relative_to(self.root)}: not collected" for path in self._files_with_tests() - self.files]
        lines += [f"{test}: skipped" for test in self.skipped if self._must_run(self.markers.get(test, set()))]
        if not any("graph" in self.markers.get(test, set()) for test in self.ran):
            lines.append("no test marked graph ran")
        if len(self.graph_processes) > 1:
            lines.append(f"tests marked graph ran in {len(self.graph_processes)} processes at once")
        return sorted(lines)

    def _must_run(self, markers: set[str]) -> bool:
        if "network" in markers and not os.environ.get("PSMNET"):
            return False
        if "real_data" in markers:
            return self.has_data
        return "graph" in markers

    def _files_with_tests(self) -> set[Path]:
        """Files under test/ that define a test, whatever their names are."""
        files = (self.root / "test").rglob("*.py")
        return {path for path in files if re.search(r"^\s*(async )?def test_", path.read_text("utf-8"), re.MULTILINE)}


def pytest_configure(config: pytest.Config) -> None:
    """Adds the watch to this run; the processes of pytest-xdist report to the one that started them."""
    if hasattr(config, "workerinput"):
        return
    config.pluginmanager.register(Completeness(config.rootpath), "completeness-of-the-run")

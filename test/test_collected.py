# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The plugin of .ci fails a run in which a file, the graph or the real data was left out, and no other run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CONFIG = '[tool.pytest.ini_options]\ntestpaths = ["test"]\nmarkers = ["graph: ", "network: ", "real_data: "]\n'
GRAPH = "import pytest\n\n@pytest.mark.graph\ndef test_graph():\n    pass\n"
GRAPH_SKIPPED = "import pytest\n\n@pytest.mark.graph\ndef test_no_ros():\n    pytest.skip('no ROS')\n"
DATA_SKIPPED = (
    "import pytest\n\n@pytest.mark.graph\n@pytest.mark.real_data\ndef test_data():\n    pytest.skip('none')\n"
)
NETWORK_SKIPPED = GRAPH_SKIPPED.replace("@pytest.mark.graph", "@pytest.mark.network\n@pytest.mark.graph")
PLAIN_SKIPPED = "import pytest\n\n@pytest.mark.skipif(True, reason='mac')\ndef test_plain():\n    pass\n"


def run(root: Path, *arguments: str, data: Path | None = None, **files: str) -> tuple[int, str]:
    """Exit code and output of pytest with the plugin in a project whose test/ holds ``files``."""
    (root / "pyproject.toml").write_text(CONFIG)
    (root / "test").mkdir()
    for name, text in files.items():
        (root / "test" / f"{name}.py").write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".ci"), "STEREO_DATA": str(data or root / "absent")}
    # the plugins of other packages take seconds to import
    environment |= {"PYTEST_ADDOPTS": "-p no:cacheprovider", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "xdist", "-p", "completeness", *arguments]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("processes", [(), ("-n", "2")], ids=["one process", "two processes"])
def test_complete_run_passes_with_absent_data_and_other_skips(
    tmp_path: Path, processes: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PSMNET", raising=False)
    skipped = {"test_b": DATA_SKIPPED, "test_c": PLAIN_SKIPPED, "test_d": NETWORK_SKIPPED}
    code, output = run(tmp_path, *processes, test_a=GRAPH, **skipped)
    assert code == 0, output
    assert "INCOMPLETE" not in output
    assert "1 passed, 3 skipped" in output


@pytest.mark.parametrize("processes", [(), ("-n", "2")], ids=["one process", "two processes"])
@pytest.mark.parametrize(
    ("files", "line"),
    [
        ({"test_a": GRAPH, "depth_tests": "def test_x():\n    pass\n"}, "test/depth_tests.py: not collected"),
        ({"test_a": GRAPH, "test_b": GRAPH_SKIPPED}, "test/test_b.py::test_no_ros: skipped"),
        ({"test_a": "def test_x():\n    pass\n"}, "no test marked graph ran"),
    ],
)
def test_incomplete_run_fails(tmp_path: Path, files: dict[str, str], line: str, processes: tuple[str, ...]) -> None:
    code, output = run(tmp_path, *processes, **files)
    assert code == 1, output
    assert f"INCOMPLETE {line}" in output
    assert " passed" in output.splitlines()[-1], "pytest's closing line comes last"


def test_graphs_beside_each_other_fail(tmp_path: Path) -> None:
    slow = "import time\n" + GRAPH.replace("pass", "time.sleep(0.5)")
    code, output = run(tmp_path, "-n", "2", **{f"test_{name}": slow for name in "abcd"})
    assert code == 1, output
    assert "INCOMPLETE tests marked graph ran in 2 processes at once" in output


def test_skipped_real_data_fails_where_the_data_is(tmp_path: Path) -> None:
    code, output = run(tmp_path, data=tmp_path, test_a=GRAPH, test_b=DATA_SKIPPED)
    assert code == 1, output
    assert "INCOMPLETE test/test_b.py::test_data: skipped" in output


def test_skipped_network_fails_where_its_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PSMNET", "network.onnx")
    code, output = run(tmp_path, test_a=GRAPH, test_b=NETWORK_SKIPPED)
    assert code == 1, output
    assert "INCOMPLETE test/test_b.py::test_no_ros: skipped" in output


def test_deselected_file_is_not_collected(tmp_path: Path) -> None:
    code, output = run(tmp_path, "test/test_a.py", test_a=GRAPH, test_b=GRAPH)
    assert code == 1, output
    assert "INCOMPLETE test/test_b.py: not collected" in output


def test_failing_run_keeps_its_exit_code(tmp_path: Path) -> None:
    code, output = run(tmp_path, test_a="import nothing_of_this_name\n\ndef test_x():\n    pass\n")
    assert code == 2, output  # an error while collecting

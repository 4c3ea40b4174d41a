# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels are compiled in one step, once, and again only when their code has changed."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from stereo_depth_ros.core import kernels
from stereo_depth_ros.core.kernels import Kernel, compile_kernels, compiled

ROOT = Path(__file__).resolve().parents[1]

KERNEL = """
from stereo_depth_ros.core.kernels import compile_kernels, compiled
from helper import helper

@compiled("int64(int64)")
def kernel(value):
    return helper(value)

@compiled("int64(int64)")
def other(value):
    return value - 1
"""
RUN = """
import kernel
# Number 0 reports that another process is waited for, one of another test.
kernel.compile_kernels(lambda number, total: number and print("compiling", number, total))
print(kernel.kernel(7), kernel.other(7))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two kernels, one of which calls a helper in another file."""
    return write_kernels(tmp_path)


@pytest.fixture(scope="module")
def once_compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_kernels(tmp_path_factory.mktemp("compiled"))
    assert run(folder) == ["compiling 1 2", "compiling 2 2", "8 6"]
    return folder


@pytest.fixture
def compiled_folder(once_compiled: Path, tmp_path: Path) -> Path:
    """The same with the code of both on disk."""
    return shutil.copytree(once_compiled, tmp_path, dirs_exist_ok=True)


def write_kernels(folder: Path) -> Path:
    (folder / "kernel.py").write_text(KERNEL)
    write_helper(folder, "value + 1")
    return folder


def write_helper(folder: Path, expression: str, comment: str = "") -> None:
    text = f"from stereo_depth_ros.core.kernels import compiled\n{comment}\n@compiled()\ndef helper(value):\n"
    (folder / "helper.py").write_text(f"{text}    return {expression}\n")


def start(folder: Path, code: str = RUN) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-c", code]
    return subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)


def run(folder: Path, code: str = RUN) -> list[str]:
    """What a new process prints."""
    process = start(folder, code)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return output.splitlines()


def test_code_is_loaded_from_disk_until_it_or_a_helper_changes(compiled_folder: Path) -> None:
    assert run(compiled_folder) == ["8 6"]
    write_helper(compiled_folder, "value * 10")
    assert run(compiled_folder) == ["compiling 1 1", "70 6"], "the kernel that calls the helper, and only that one"


def test_moved_lines_and_other_files_compile_nothing(compiled_folder: Path) -> None:
    write_helper(compiled_folder, "value + 1", comment="# a comment\n\n\n")
    (compiled_folder / "kernel.py").write_text(f'"""A new docstring."""\n\n{KERNEL}')
    (compiled_folder / "plot.py").write_text("color = 1\n")
    assert run(compiled_folder) == ["8 6"]


def test_constants_are_part_of_the_code(folder: Path) -> None:
    write_helper(folder, "value + STEP", comment="STEP = 3")
    assert run(folder)[-1] == "10 6"
    write_helper(folder, "value + STEP", comment="STEP = 5")
    assert run(folder) == ["compiling 1 1", "12 6"]


def test_of_concurrent_processes_one_compiles(folder: Path) -> None:
    processes = [start(folder) for _ in range(3)]
    outputs = [process.communicate(timeout=240)[0].splitlines() for process in processes]
    assert [process.returncode for process in processes] == [0, 0, 0]
    assert [output[-1] for output in outputs] == ["8 6"] * 3
    assert sum(line.startswith("compiling") for output in outputs for line in output) == 2


@pytest.mark.parametrize("damage", [b"", b"\x80\x04cno_such_module\nname\n."], ids=["cut", "module that is missing"])
def test_a_cache_that_cannot_be_loaded_is_compiled_again(compiled_folder: Path, damage: bytes) -> None:
    for path in (compiled_folder / "__pycache__").glob("kernel.*.nbc"):
        path.write_bytes(damage)
    assert run(compiled_folder)[-1] == "8 6"


def test_code_that_refers_to_generated_functions_is_loaded() -> None:
    """Numba names their module <dynamic>, and imports it to load the code."""
    assert importlib.import_module("<dynamic>").__name__ == "<dynamic>"


def test_waiting_for_another_process_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wait is progress too: who watches the start of nodes counts from the last report."""

    @compiled("int64(int64)")
    def triple(value: int) -> int:
        return 3 * value

    assert isinstance(triple, Kernel)
    triple._index.flush()  # of an earlier run
    monkeypatch.setattr(kernels, "_WAITING_S", 0.2)
    monkeypatch.setattr(kernels, "_pending", [triple])
    reports = []
    with ExitStack() as another_process:  # flock is of the open file
        assert another_process.enter_context(triple.lock())

        def report(number: int, total: int) -> None:
            reports.append((number, total))
            another_process.close()

        compile_kernels(report)
    assert reports == [(0, 1), (1, 1)]
    assert triple(5) == 15


def test_while_another_process_compiles_a_kernel_the_others_are_compiled(folder: Path) -> None:
    lock = folder / "__pycache__" / f"kernel.kernel.{kernels._PYTHON}.{os.getuid()}.lock"
    with kernels._file_lock(lock) as locked:
        assert locked
        process = start(folder)
        watchdog = threading.Timer(120, process.kill)
        watchdog.start()
        assert process.stdout is not None and process.stdout.readline() == "compiling 1 2\n"
    output, _ = process.communicate(timeout=120)
    watchdog.cancel()
    assert output.splitlines() == ["compiling 2 2", "8 6"]


def test_first_call_compiles() -> None:
    @compiled("float64(float64)")
    def half(value: float) -> float:
        return value / 2

    assert isinstance(half, Kernel)
    assert half(5.0) == 2.5
    compile_kernels(lambda number, total: pytest.fail("nothing is left to compile"))


def test_code_is_read_without_the_tables_of_the_compiler(folder: Path) -> None:
    """They are most of the start of a node; numba builds them when it compiles."""
    code = f"{RUN}\nimport sys\nprint('numba.typed.typedlist' in sys.modules)"
    assert run(folder, code)[-1] == "True"
    assert run(folder, code) == ["8 6", "False"]


def test_values_that_a_function_was_made_with_are_part_of_the_code() -> None:
    def adds(step: int) -> Callable[[int], int]:
        return lambda value: value + step

    assert kernels._fingerprint(adds(1), "") == kernels._fingerprint(adds(1), "")
    assert kernels._fingerprint(adds(1), "") != kernels._fingerprint(adds(2), "")

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process ends in time after SIGINT or SIGTERM, also while it is imported or its main thread is in a kernel."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import FrameType

import pytest

from stereo_depth_ros.core.interrupts import handled_signals

ROOT = Path(__file__).resolve().parents[1]
BOTH = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])

# A lock that is never released, waited for in C: like a kernel, it runs no instruction of Python and needs no lock.
IN_A_KERNEL = """
import ctypes, functools, os
from stereo_depth_ros.core.interrupts import handled_signals
libc, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(64)
libc.pthread_mutex_lock(mutex)
with handled_signals(lambda *_: None, 0.1, functools.partial(os.write, 1, b"ended"), functools.partial(os._exit, 7)):
    print("ready", flush=True)
    libc.pthread_mutex_lock(mutex)
"""

# A clean-up that hangs in C with the interpreter lock held, as PyDLL does not release it: no thread of Python runs.
HANGING = """
import ctypes, signal, sys
from rclpy.node import Node
from stereo_depth_ros.nodes import runner
from stereo_depth_ros.nodes.depth_node import DepthNode
runner._SHUTDOWN_TIMEOUT_S = 0.2
Node.destroy_node = lambda self: ctypes.PyDLL(None).sleep(60)
runner.announce_ready = lambda node: print("ready", flush=True)
sys.exit(runner.run(DepthNode))
"""

# The first import of the program waits for ever.
IMPORTED = """
import importlib.abc, sys, threading
class Slow(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in ("numpy", "typer"):
            print("ready", flush=True)
            threading.Event().wait(60)
sys.meta_path.insert(0, Slow())
"""


def ended_by(number: int, code: str) -> tuple[int, str, str]:
    """Exit code, output and errors of Python code that is sent a signal when it prints a line."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    with subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout and process.stdout.readline() == "ready\n"
            process.send_signal(number)
            out, err = process.communicate(timeout=50)
        finally:
            process.kill()
    return process.returncode, out, err


@BOTH
def test_a_process_ends_while_its_main_thread_is_in_a_kernel(number: int) -> None:
    assert ended_by(number, IN_A_KERNEL) == (7, "ended", "")


@pytest.mark.graph
@BOTH
def test_a_node_whose_clean_up_hangs_ends_with_0_and_says_where(number: int) -> None:
    code, _, err = ended_by(number, HANGING)
    assert code == 0, err
    assert "Timeout (0:00:00.2" in err and "in _run" in err


@pytest.mark.parametrize("exit_code", [0, 9])
def test_a_block_that_hangs_ends_the_process_with_the_exit_code(exit_code: int) -> None:
    code = (
        "import ctypes\nfrom stereo_depth_ros.core.interrupts import ended_within\n"
        f"with ended_within(0.1, {exit_code}):\n    ctypes.PyDLL(None).sleep(60)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=50)
    assert done.returncode == exit_code, done.stderr
    assert "line 4 in <module>" in done.stderr


def test_a_block_that_does_not_hang_leaves_no_timer() -> None:
    """The process goes on for longer than the block had."""
    code = (
        "import time\nfrom stereo_depth_ros.core import interrupts\ninterrupts._TRACEBACK_S = 0.0\n"
        "with interrupts.ended_within(0.1, 9):\n    pass\ntime.sleep(0.3)\nprint('end')"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=50)
    assert (done.returncode, done.stdout, done.stderr) == (0, "end\n", "")


@BOTH
def test_a_command_ends_while_it_is_imported(number: int) -> None:
    program = "from stereo_depth_ros.cli.start import main\nmain()\n"
    assert ended_by(number, IMPORTED + program) == (130, "", "interrupted: nothing was written\n")


@BOTH
@pytest.mark.parametrize(
    "program",
    [
        "from stereo_depth_ros.nodes.start import depth_node\ndepth_node()\n",
        # as `python -m` imports the package of the module
        "sys.argv[0] = '-m'\nimport stereo_depth_ros.nodes\nimport stereo_depth_ros.nodes.depth_node\n",
    ],
    ids=["executable", "module"],
)
def test_a_node_ends_while_it_is_imported(number: int, program: str) -> None:
    assert ended_by(number, IMPORTED + program) == (0, "", "")


def test_a_program_that_imports_nodes_keeps_its_handlers() -> None:
    code = (
        "import signal\nbefore = signal.getsignal(signal.SIGINT)\nimport stereo_depth_ros.nodes.start\n"
        "print(signal.getsignal(signal.SIGINT) is before)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.stdout == "True\n", done.stderr


def handlers() -> list[object]:
    return [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]


@BOTH
def test_a_block_that_ends_in_time_makes_no_call(number: int) -> None:
    received, called = [], threading.Event()

    def note(number: int, _: FrameType | None) -> None:
        received.append(number)

    before, threads = handlers(), threading.active_count()
    with handled_signals(note, 60, called.set):
        signal.raise_signal(number)
        assert received == [number]
    for thread in threading.enumerate():
        if thread.name == "signals":
            thread.join(10)
    assert not called.is_set()
    assert (handlers(), threading.active_count()) == (before, threads)


@BOTH
def test_a_block_that_goes_on_makes_the_calls_in_order(number: int) -> None:
    calls: list[int] = []
    made = threading.Event()
    with handled_signals(lambda *_: None, 0, lambda: calls.append(1), lambda: calls.append(2), made.set):
        signal.raise_signal(number)
        assert made.wait(30)
    assert calls == [1, 2]


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    """As in a command that a shell script runs in the background."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with handled_signals(lambda *_: pytest.fail("handled"), 60):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)

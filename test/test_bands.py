# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bands cover each row once, from any thread, and errors are raised in the caller."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled


@pytest.fixture(params=[1, 2, 5])
def cores(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(parallel, "core_count", lambda: request.param)
    return int(request.param)


@compiled("void(int64, int64, int64[::1], int64)")
def _add(first: int, last: int, counts: np.ndarray, amount: int) -> None:
    for y in range(first, last):
        counts[y] += amount


@pytest.mark.parametrize("rows", [1, 63, 64, 129, 481])
def test_each_row_is_visited_once(cores: int, rows: int) -> None:
    counts = np.zeros(rows, np.int64)
    run_bands(_add, rows, counts, 3)
    assert (counts == 3).all()


def test_number_of_bands(cores: int) -> None:
    bands: list[tuple[int, int]] = []
    run_bands(lambda first, last: bands.append((first, last)), 300)
    assert len(bands) == min(cores, 300 // 64)
    bands.clear()
    run_bands(lambda first, last: bands.append((first, last)), 300, min_rows=301)
    assert bands == [(0, 300)]
    run_bands(lambda first, last: bands.append((first, last)), 0)
    assert bands == [(0, 300)]


@pytest.mark.parametrize("failing", [0, 1])
def test_exception_is_raised_after_all_bands(monkeypatch: pytest.MonkeyPatch, failing: int) -> None:
    monkeypatch.setattr(parallel, "core_count", lambda: 3)
    done: list[int] = []

    def kernel(first: int, last: int) -> None:
        if first == 100 * failing:
            raise ValueError(f"band at {first}")
        done.append(first)

    with pytest.raises(ValueError, match=f"band at {100 * failing}"):
        run_bands(kernel, 300)
    assert sorted(done) == [first for first in (0, 100, 200) if first != 100 * failing]


def test_many_threads_at_once(cores: int) -> None:
    arrays = [np.zeros(640, np.int64) for _ in range(8)]

    def work(counts: np.ndarray) -> None:
        for _ in range(50):
            run_bands(_add, 640, counts, 1)

    with ThreadPoolExecutor(8) as callers:
        list(callers.map(work, arrays))
    assert all((counts == 50).all() for counts in arrays)


def test_nested_calls_do_not_deadlock(cores: int) -> None:
    counts = np.zeros(640, np.int64)

    def outer(first: int, last: int) -> None:
        run_bands(lambda a, b: run_bands(_add, last - first, counts[first:last], 1, min_rows=16), 1)

    thread = threading.Thread(target=run_bands, args=(outer, 640), daemon=True)
    thread.start()
    thread.join(20)
    assert not thread.is_alive(), "nested bands deadlock"
    assert (counts == 1).all()


def test_works_in_a_forked_child() -> None:
    program = """
import os, sys
from stereo_depth_ros.core import bands as parallel
parallel.core_count = lambda: 3
def work():
    rows = []
    parallel.run_bands(lambda first, last: rows.extend(range(first, last)), 300)
    return sorted(rows) == list(range(300))
assert work()
child = os.fork()
if child == 0:
    os._exit(0 if work() else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    result = subprocess.run([sys.executable, "-c", program], timeout=60, check=False)
    assert result.returncode == 0


def test_a_process_that_is_interrupted_while_a_thread_starts_ends() -> None:
    program = """
import threading
from stereo_depth_ros.core import bands
bands.core_count = lambda: 2
start = threading.Thread.start
def interrupted(thread):
    start(thread)
    raise KeyboardInterrupt
threading.Thread.start = interrupted
bands.run_bands(lambda first, last: None, 300)
"""
    result = subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, timeout=60, check=False)
    assert result.returncode == -signal.SIGINT, result.stderr

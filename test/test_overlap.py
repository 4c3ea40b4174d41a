# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames overlap: each step in order, as many worked on as allowed, the oldest waiting ones dropped."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from typing import Any

import pytest

from stereo_depth_ros.core.overlap import Overlap

TIMEOUT_S = 20.0


class Steps:
    """Steps that note what they do; the work on a frame waits until the test lets it go on."""

    def __init__(self, at_once: int) -> None:
        self.prepared: list[int] = []
        self.delivered: list[int | str] = []
        self.working: set[int] = set()
        self.most_at_once = 0
        self.may_end: dict[int, threading.Event] = {frame: threading.Event() for frame in range(20)}
        self.changed = threading.Condition()
        # As the stage of the matcher does: it lets this many work at the same time.
        self._places = threading.Semaphore(at_once)
        self.overlap: Overlap[int, int, int] = Overlap(self._prepare, self._work, self._deliver, lambda _: at_once)

    def _prepare(self, frame: int) -> int:
        with self.changed:
            self.prepared.append(frame)
            self.changed.notify_all()
        if frame == 13:
            raise ValueError("frame 13")
        return frame

    def _work(self, frame: int) -> int:
        with self._places:
            with self.changed:
                self.working.add(frame)
                self.most_at_once = max(self.most_at_once, len(self.working))
                self.changed.notify_all()
            assert self.may_end[frame].wait(TIMEOUT_S), f"frame {frame} was never let go on"
            with self.changed:
                self.working.remove(frame)
                self.changed.notify_all()
        return 100 + frame

    def _deliver(self, result: Future[int]) -> None:
        error = result.exception()
        with self.changed:
            self.delivered.append(str(error) if error else result.result())
            self.changed.notify_all()

    def wait(self, condition: Callable[[], bool], missing: str) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, TIMEOUT_S), f"{missing}: {self.prepared}, {self.delivered}"


@pytest.fixture
def threads() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(8) as pool:
        yield pool


def run_overlapped(steps: Steps, threads: ThreadPoolExecutor, frames: list[int], limit: int = 100) -> list[Any]:
    steps.overlap.begin_overlap()
    runs = []
    for frame in frames:
        steps.overlap.add(frame, limit)
        runs.append(threads.submit(steps.overlap.run_one))
    return runs


def test_add_runs_a_frame_itself_until_frames_overlap() -> None:
    steps = Steps(at_once=1)
    steps.may_end[3].set()
    assert steps.overlap.add(3, limit=1) == 0
    assert steps.delivered == [103]
    assert not steps.overlap.run_one()


def test_next_frame_is_prepared_while_one_is_worked_on(threads: ThreadPoolExecutor) -> None:
    steps = Steps(at_once=1)
    runs = run_overlapped(steps, threads, [0, 1, 2])
    steps.wait(lambda: steps.prepared == [0, 1, 2], "frames that come after frame 0 were not prepared")
    assert steps.working <= {0}
    for frame in (2, 1, 0):
        steps.may_end[frame].set()
    assert [run.result(TIMEOUT_S) for run in runs] == [True, True, True]
    assert steps.delivered == [100, 101, 102]
    assert steps.most_at_once == 1


def test_results_are_delivered_in_the_order_of_the_frames(threads: ThreadPoolExecutor) -> None:
    steps = Steps(at_once=2)
    runs = run_overlapped(steps, threads, [0, 1])
    steps.wait(lambda: steps.working == {0, 1}, "two frames were not worked on at the same time")
    steps.may_end[1].set()  # the newer one ends first
    steps.wait(lambda: steps.working == {0}, "frame 1 did not end")
    assert steps.delivered == []
    steps.may_end[0].set()
    assert all(run.result(TIMEOUT_S) for run in runs)
    assert steps.delivered == [100, 101]


def test_frames_under_way_are_limited(threads: ThreadPoolExecutor) -> None:
    """One is worked on, one is prepared, one may be delivered; others wait for the thread that ends first."""
    steps = Steps(at_once=1)
    runs = run_overlapped(steps, threads, [0, 1, 2, 3, 4])
    left = [run.result(TIMEOUT_S) for run in itertools.islice(as_completed(runs, TIMEOUT_S), 2)]
    assert left == [False, False]
    steps.wait(lambda: steps.prepared == [0, 1, 2], "three frames were not begun")
    for event in steps.may_end.values():
        event.set()
    assert sorted(run.result(TIMEOUT_S) for run in runs) == [False, False, True, True, True]
    assert steps.overlap.run_one()
    assert steps.overlap.run_one()
    assert not steps.overlap.run_one()
    assert steps.delivered == [100, 101, 102, 103, 104]


def test_oldest_waiting_frames_are_dropped_and_counted(threads: ThreadPoolExecutor) -> None:
    steps = Steps(at_once=1)
    runs = run_overlapped(steps, threads, [0])
    steps.wait(lambda: steps.working == {0}, "frame 0 was not begun")
    assert [steps.overlap.add(frame, limit=3) for frame in (1, 2, 3, 4, 5)] == [0, 0, 0, 1, 1]
    for event in steps.may_end.values():
        event.set()
    assert runs[0].result(TIMEOUT_S)
    while steps.overlap.run_one():
        pass
    assert steps.delivered == [100, 103, 104, 105]


def test_newest_frame_is_kept_with_the_smallest_limit(threads: ThreadPoolExecutor) -> None:
    steps = Steps(at_once=2)
    runs = run_overlapped(steps, threads, [0, 1, 2])
    steps.wait(lambda: steps.prepared == [0, 1, 2], "three frames were not begun")
    assert [steps.overlap.add(frame, limit=1) for frame in (3, 4, 5)] == [0, 1, 1]
    for event in steps.may_end.values():
        event.set()
    assert all(run.result(TIMEOUT_S) for run in runs)
    assert steps.overlap.run_one()
    assert steps.delivered == [100, 101, 102, 105]


def test_errors_are_delivered_in_their_place(threads: ThreadPoolExecutor) -> None:
    steps = Steps(at_once=1)
    for event in steps.may_end.values():
        event.set()
    runs = run_overlapped(steps, threads, [12, 13, 14])
    assert all(run.result(TIMEOUT_S) for run in runs)
    assert steps.delivered == [112, "frame 13", 114]


def test_waiting_frames_can_be_dropped() -> None:
    steps = Steps(at_once=1)
    steps.overlap.begin_overlap()
    steps.overlap.add(0, limit=5)
    steps.overlap.drop_waiting()
    assert not steps.overlap.run_one()
    assert steps.prepared == []

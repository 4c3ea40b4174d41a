# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps the processing of consecutive frames: each in one thread, several threads at once, results in order."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

__all__ = ["BESIDE_WORK", "Overlap"]

BESIDE_WORK = 2  # frames under way besides those worked on: one is prepared, one is delivered

Frame = TypeVar("Frame")
Prepared = TypeVar("Prepared")
Result = TypeVar("Result")


class Overlap(Generic[Frame, Prepared, Result]):
    """A queue of frames for three steps: while one frame is worked on, the next is prepared and the last delivered.

    It has no threads of its own. Whoever calls :meth:`run_one` takes a frame through all steps; so the thread that has
    received a frame can go on with it at once, without waking another one. Frames are prepared and delivered one by
    one, in the order in which they were added. Until :meth:`begin_overlap` is called, :meth:`add` runs each frame
    itself.

    Args:
        prepare: the first step.
        work: the second step, the longest one.
        deliver: the last step, given the future of the result: its ``result()`` raises what an earlier step raised. It
            must not raise itself.
        at_once: how many frames like this one may be worked on at the same time, at least 1.
    """

    def __init__(
        self,
        prepare: Callable[[Frame], Prepared],
        work: Callable[[Prepared], Result],
        deliver: Callable[[Future[Result]], None],
        at_once: Callable[[Frame], int],
    ) -> None:
        self._prepare, self._work, self._deliver, self._at_once = prepare, work, deliver, at_once
        self._waiting: deque[Frame] = deque()
        self._changed = threading.Condition()
        self._begun = self._prepared = self._delivered = 0  # frames so far
        self._overlaps = False

    def begin_overlap(self) -> None:
        """From now on :meth:`add` only queues the frame, and several threads call :meth:`run_one`."""
        self._overlaps = True

    def add(self, frame: Frame, limit: int) -> int:
        """Add a frame; where too many are waiting, drop the oldest ones.

        Args:
            frame: the newest one.
            limit: most frames, at least 1, that are not delivered yet, besides the one worked on.

        Returns:
            How many were dropped.
        """
        with self._changed:
            self._waiting.append(frame)
            dropped = max(0, len(self._waiting) - max(1, limit + 1 - (self._begun - self._delivered)))
            for _ in range(dropped):
                self._waiting.popleft()
        if not self._overlaps:
            self.run_one()
        return dropped

    def drop_waiting(self) -> None:
        """Drop the frames that no thread has begun."""
        with self._changed:
            self._waiting.clear()

    def run_one(self) -> bool:
        """Take the oldest waiting frame through all steps, unless enough frames are under way.

        Returns:
            Whether there was one. The caller should call again: another frame may have come, and waits for it.
        """
        with self._changed:
            if not self._waiting or self._begun - self._delivered >= self._at_once(self._waiting[0]) + BESIDE_WORK:
                return False
            frame, turn = self._waiting.popleft(), self._begun
            self._begun += 1
            self._changed.wait_for(lambda: self._prepared == turn)
        result: Future[Result] = Future()
        try:
            try:
                prepared = self._prepare(frame)
            finally:
                with self._changed:
                    self._prepared += 1
                    self._changed.notify_all()
            result.set_result(self._work(prepared))
        except Exception as error:  # for the one who delivers
            result.set_exception(error)
        with self._changed:
            self._changed.wait_for(lambda: self._delivered == turn)
        try:
            self._deliver(result)
        finally:
            with self._changed:
                self._delivered += 1
                self._changed.notify_all()
        return True

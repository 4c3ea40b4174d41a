# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Collects captures of a projected sequence from a stream: one for each pattern, announced or found by its change."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import U8

__all__ = ["AnnouncedPatterns", "ChangingPatterns"]

T = TypeVar("T")

_STRIDE = 3  # of the pixels that are compared
_CHANGED_SHARE = 0.01  # of the pixels
_LEVELS = (6.0, 16.0)  # a pixel has changed by this much at least: where there is little noise, and at the start
_NOISES = 5.0


class AnnouncedPatterns(Generic[T]):
    """Collects captures while somebody says which pattern is shown.

    Args:
        count: patterns of the sequence.
        settle: captures that are skipped after an announcement, while projector and camera settle.

    Attributes:
        taken: the captures so far, by number of the pattern from 0.
        abandoned: sequences that began again before they were complete.
    """

    def __init__(self, count: int, settle: int) -> None:
        self._count = count
        self.settle = settle
        self.taken: dict[int, T] = {}
        self.abandoned = 0
        self._shown: int | None = None
        self._skip = 0
        self._done = False  # what is shown belongs to the sequence that is complete
        self._calibration: object = None

    @property
    def missing(self) -> list[int]:
        """Numbers of the patterns that have no capture yet, from 0."""
        return [number for number in range(self._count) if number not in self.taken]

    def restart(self) -> None:
        """Forget the captures of an incomplete sequence."""
        self.abandoned += bool(self.taken)
        self.taken.clear()
        self._shown = None

    def show(self, number: int) -> None:
        """Pattern ``number`` is shown from now on; said again, it changes nothing. The first one begins a sequence.

        Raises:
            ConfigError: there is no such pattern.
        """
        if not 0 <= number < self._count:
            raise ConfigError(
                f"pattern {number} is announced, the sequence has 0 to {self._count - 1}",
                value=number,
                limit=(0, self._count - 1),
                remedy="count the patterns from 0, and use the manifest of the patterns that are shown",
                settings=("patterns",),
            )
        if number == self._shown:
            return
        if number == 0 and 0 in self.taken:
            self.restart()
        self._shown, self._skip, self._done = number, self.settle, False

    def add(self, capture: T, calibration: object = None) -> list[T] | None:
        """One capture; all in the order of the patterns with the last one that was missing, else None.

        Captures of another calibration object than that of the one before begin a sequence.
        """
        if calibration is not self._calibration:
            self.abandoned += bool(self.taken)
            self.taken.clear()
            self._calibration = calibration
        if self._shown is None or self._shown in self.taken or self._done:
            return None
        if self._skip:
            self._skip -= 1
            return None
        self.taken[self._shown] = capture
        if self.missing:
            return None
        complete = [self.taken[number] for number in range(self._count)]
        self.taken = {}
        self._done = self._count > 1
        return complete


class ChangingPatterns(Generic[T]):
    """Collects captures where nothing but the images tells which pattern they show.

    A capture that differs from the one before begins a pattern; after ``settle`` more that do not differ it is taken.
    The last ones taken are a sequence where ``fault`` finds none in them: what was shown before it began drops out.

    Args:
        count: patterns of the sequence.
        settle: captures that are skipped after a change; with 0 every capture is the next pattern.
        gray: the gray image of a camera in a capture, uint8 (H, W).
        fault: why captures are not the sequence, in its order; empty where they are.

    Attributes:
        seen: patterns since the last sequence.
        fault: why the last ones are no sequence; empty where there are too few to tell.
        abandoned: sequences that another calibration cut off.
    """

    def __init__(self, count: int, settle: int, gray: Callable[[T], U8], fault: Callable[[list[T]], str]) -> None:
        self._count = count
        self.settle = settle
        self._gray = gray
        self._fault = fault
        self._taken: deque[T] = deque(maxlen=count)
        self._before: U8 | None = None
        self._noise = _LEVELS[1] / _NOISES
        self._quiet = 0
        self._calibration: object = None
        self.seen = 0
        self.fault = ""
        self.abandoned = 0

    def restart(self) -> None:
        """Forget what was taken."""
        self._taken.clear()
        self._before = None
        self._quiet = self.seen = 0
        self.fault = ""

    def add(self, capture: T, calibration: object = None) -> list[T] | None:
        """One capture; the captures of the sequence that it completes, else None.

        Captures of another calibration object than that of the one before begin a sequence.
        """
        if calibration is not self._calibration:
            self.abandoned += bool(self._taken)
            self.restart()
            self._calibration = calibration
        if self.settle:
            self._quiet = 0 if self._has_changed(self._gray(capture)) else self._quiet + 1
            if self._quiet != self.settle:
                return None
        self.seen += 1
        self._taken.append(capture)
        if len(self._taken) < self._count:
            return None
        captures = list(self._taken)
        self.fault = self._fault(captures)
        if self.fault:
            return None
        self._taken.clear()
        self.seen = 0
        return captures

    def _has_changed(self, image: U8) -> bool:
        pixels = image[::_STRIDE, ::_STRIDE]
        before, self._before = self._before, pixels.copy()
        if before is None or before.shape != pixels.shape:
            return True
        difference = np.abs(pixels.astype(np.int16) - before)
        self._noise = min(self._noise, 1.48 * float(np.median(difference)))
        limit = min(max(_NOISES * self._noise, _LEVELS[0]), _LEVELS[1])
        return bool(np.count_nonzero(difference > limit) > _CHANGED_SHARE * difference.size)

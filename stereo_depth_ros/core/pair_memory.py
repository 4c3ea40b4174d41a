# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of the newest pairs of a stream, for methods that match several pairs together."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

__all__ = ["PairMemory"]

Pair = TypeVar("Pair")


class PairMemory(Generic[Pair]):
    """The pairs before each pair of a stream, as far as they belong together.

    It forgets all pairs where the next one is of another kind (another size or calibration), has an earlier stamp (the
    stream has begun again), or comes later than ``gap_ns`` after the one before. A single pair that is missing is
    tolerated: the pairs around it are matched together.

    Thread-safe; the pairs are taken in the order of the calls.

    Args:
        length: number of pairs matched together, the newest one included, at least 1.
        gap_ns: longest time between successive pairs, nanoseconds; None means no limit.
    """

    def __init__(self, length: int, gap_ns: int | None = None) -> None:
        self._pairs: deque[Pair] = deque(maxlen=length - 1)
        self._gap_ns = gap_ns
        self._last: tuple[int, object] | None = None
        self._turn = threading.Lock()

    def add(self, pair: Pair, stamp_ns: int, kind: object) -> tuple[Pair, ...]:
        """The pairs before this one that are matched together with it, the oldest first; it is kept for the next ones.

        Args:
            pair: the newest one.
            stamp_ns: its time, nanoseconds. Stamps that are not set are all equal, which does not make it forget.
            kind: of the pair; pairs are matched together while it stays equal.
        """
        if not self._pairs.maxlen:
            return ()
        with self._turn:
            if self._last is not None and not self._continues(stamp_ns, kind, *self._last):
                self._pairs.clear()
            before = tuple(self._pairs)
            self._pairs.append(pair)
            self._last = (stamp_ns, kind)
        return before

    def _continues(self, stamp_ns: int, kind: object, last_ns: int, last_kind: object) -> bool:
        step_ns = stamp_ns - last_ns
        return kind == last_kind and step_ns >= 0 and (self._gap_ns is None or step_ns <= self._gap_ns)

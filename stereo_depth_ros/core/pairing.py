# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairing of left and right messages by stamp."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

__all__ = ["PairingCounts", "PairingLimits", "StereoPairing"]

T = TypeVar("T")
MAX_STEP_BACK_NS = 10**9


class PairingLimits(Protocol):
    """Limits of the pairing: queue size and tolerance."""

    @property
    def queue_size(self) -> int:
        """Unpaired items kept per side, at least 1."""

    @property
    def tolerance_ns(self) -> int | None:
        """Largest stamp difference within a pair, nanoseconds; None means no limit."""


@dataclass(frozen=True)
class PairingCounts:
    """Counts of messages by outcome.

    Attributes:
        paired: pairs released.
        dropped_left, dropped_right: messages without a partner.
        duplicates: messages of either camera with the stamp of a queued message, or of the last one released.
        backwards: number of times the clock was set back and both queues were cleared.
    """

    paired: int = 0
    dropped_left: int = 0
    dropped_right: int = 0
    duplicates: int = 0
    backwards: int = 0


class StereoPairing(Generic[T]):
    """Pairs left and right items by stamp.

    Pairs are released in order of their stamps, and each item is in one pair at most. Of the oldest queued items of the
    two cameras, the earlier is paired with the later one unless their difference exceeds the tolerance or the next item
    of the earlier camera is closer. That next item is awaited only if it could be closer: none is expected sooner than
    the shortest interval of the camera so far, so a difference of up to half of it is paired immediately. Only stamps
    decide, so the same stamps give the same pairs for any interleaving of the two cameras, within the queue size.

    An item is dropped as soon as it cannot be paired any more: the other camera is past its stamp plus the tolerance, a
    later item of the same camera is closer or has been released, or the queue is full. A late item is paired as long as
    no later one was released. A stamp more than 1 s before the newest of its camera, or more than ``queue_size`` late
    ones in a row, means that the clock was set back, as when a bag is looped: both queues are cleared. Not thread-safe.

    Args:
        limits: queue size and tolerance.

    Attributes:
        right_queue_size: unpaired right items kept; it may be changed at any time, for items that arrive long before
            their partners.
    """

    def __init__(self, limits: PairingLimits) -> None:
        self._tolerance_ns = limits.tolerance_ns
        self._queue_size = self.right_queue_size = limits.queue_size
        self._left: _Side[T] = _Side()
        self._right: _Side[T] = _Side()
        self._paired = 0
        self._backwards = 0

    def add_left(self, stamp_ns: int, item: T) -> list[tuple[T, T]]:
        """Add a left item; returns the (left, right) pairs that are now complete, in order."""
        return self._add(self._left, stamp_ns, item, self._queue_size)

    def add_right(self, stamp_ns: int, item: T) -> list[tuple[T, T]]:
        """Add a right item; returns the (left, right) pairs that are now complete, in order."""
        return self._add(self._right, stamp_ns, item, self.right_queue_size)

    def flush(self) -> list[tuple[T, T]]:
        """The pairs that awaited a closer item, at the end of the streams; unpaired items are dropped."""
        pairs = self._release(final=True)
        self._clear()
        return pairs

    @property
    def counts(self) -> PairingCounts:
        """Counts so far; the items of both cameras add up to 2 paired + dropped + duplicates + pending."""
        duplicates = self._left.duplicates + self._right.duplicates
        return PairingCounts(self._paired, self._left.dropped, self._right.dropped, duplicates, self._backwards)

    @property
    def pending_left(self) -> int:
        """Number of queued left items."""
        return len(self._left.queue)

    @property
    def pending_right(self) -> int:
        """Number of queued right items."""
        return len(self._right.queue)

    def _add(self, side: _Side[T], stamp_ns: int, item: T, queue_size: int) -> list[tuple[T, T]]:
        if side.is_clock_set_back(stamp_ns, self._queue_size):
            self._backwards += 1
            self._clear()
        side.insert(stamp_ns, item)
        pairs = self._release()
        if len(side.queue) > queue_size:
            pairs += self._release(final=True)
        while len(side.queue) > queue_size:
            side.drop_oldest()
        return pairs

    def _release(self, final: bool = False) -> list[tuple[T, T]]:
        """Pair and drop from the oldest items on, until the outcome depends on later items; all of them if final."""
        pairs = []
        while self._left.queue and self._right.queue:
            earlier, later = sorted((self._left, self._right), key=lambda side: side.queue[0].stamp_ns)
            is_unpaired = self._is_unpaired(earlier, later.queue[0].stamp_ns)
            if is_unpaired is None and not final:
                break
            if is_unpaired:
                earlier.drop_oldest()
            else:
                pairs.append((self._left.take_oldest(), self._right.take_oldest()))
        self._paired += len(pairs)
        return pairs

    def _is_unpaired(self, side: _Side[T], partner_ns: int) -> bool | None:
        """Whether the oldest item of ``side`` is not paired with the later ``partner_ns``; None while undecided."""
        oldest = side.queue[0]
        difference_ns = partner_ns - oldest.stamp_ns
        if self._tolerance_ns is not None and difference_ns > self._tolerance_ns:
            return True
        if 2 * difference_ns <= oldest.shortest_interval_ns:
            return False
        if len(side.queue) == 1:
            return None
        return abs(side.queue[1].stamp_ns - partner_ns) < difference_ns

    def _clear(self) -> None:
        self._left.reset()
        self._right.reset()


@dataclass(frozen=True)
class _Waiting(Generic[T]):
    stamp_ns: int
    item: T
    shortest_interval_ns: int  # of its camera, up to this stamp; 0 while there is none


class _Side(Generic[T]):
    """Queued items of one camera by stamp, and the state of its clock."""

    def __init__(self) -> None:
        self.queue: list[_Waiting[T]] = []
        self.dropped = 0
        self.duplicates = 0
        self.reset()

    def reset(self) -> None:
        """Drop all queued items and reset the clock."""
        self.dropped += len(self.queue)
        self.queue.clear()
        self._newest_ns: int | None = None
        self._released_ns: int | None = None  # newest stamp that left the queue
        self._shortest_interval_ns = 0
        self._late_in_a_row = 0

    def is_clock_set_back(self, stamp_ns: int, queue_size: int) -> bool:
        """Whether a stamp is so old that the clock must have been set back."""
        far_back = self._newest_ns is not None and self._newest_ns - stamp_ns > MAX_STEP_BACK_NS
        return far_back or (self._is_too_late(stamp_ns) and self._late_in_a_row >= queue_size)

    def insert(self, stamp_ns: int, item: T) -> None:
        """Queue an item by its stamp, or count it as duplicate or dropped."""
        at = bisect_left([waiting.stamp_ns for waiting in self.queue], stamp_ns)
        if stamp_ns == self._released_ns or (at < len(self.queue) and self.queue[at].stamp_ns == stamp_ns):
            self.duplicates += 1
        elif self._is_too_late(stamp_ns):
            self.dropped += 1
            self._late_in_a_row += 1
        else:
            self._observe_clock(stamp_ns)
            self.queue.insert(at, _Waiting(stamp_ns, item, self._shortest_interval_ns))

    def take_oldest(self) -> T:
        """Remove the oldest item for a pair."""
        waiting = self.queue.pop(0)
        self._released_ns = waiting.stamp_ns
        return waiting.item

    def drop_oldest(self) -> None:
        """Remove the oldest item without a partner."""
        self.take_oldest()
        self.dropped += 1

    def _is_too_late(self, stamp_ns: int) -> bool:
        return self._released_ns is not None and stamp_ns < self._released_ns

    def _observe_clock(self, stamp_ns: int) -> None:
        self._late_in_a_row = 0
        if self._newest_ns is None:
            self._newest_ns = stamp_ns
        elif stamp_ns > self._newest_ns:
            interval_ns = stamp_ns - self._newest_ns
            self._shortest_interval_ns = min(interval_ns, self._shortest_interval_ns or interval_ns)
            self._newest_ns = stamp_ns

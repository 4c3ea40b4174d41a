# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tracks which outputs of which pairs have been received; no ROS, no I/O."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from stereo_depth_ros.offline.report import OutputStats

__all__ = ["LostPair", "PairTracker"]


@dataclass(frozen=True)
class LostPair:
    """A pair given up, and its missing outputs; ``without_output`` when all are missing."""

    stamp_ns: int
    topics: tuple[str, ...]
    without_output: bool


@dataclass
class _Outstanding:
    stamp_ns: int
    sent_ns: int
    last_sent_ns: int
    missing: set[str]


@dataclass
class _Topic:
    received: int = 0
    lost: int = 0
    latencies_ms: list[float] = field(default_factory=list)


class PairTracker:
    """Matches received outputs with sent pairs by stamp.

    Args:
        topics: the outputs every pair has.
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self._topics = {topic: _Topic() for topic in topics}
        self._outstanding: dict[int, _Outstanding] = {}

    @property
    def pending(self) -> int:
        """Number of pairs sent whose outputs are incomplete."""
        return len({id(pair) for pair in self._outstanding.values()})

    def sent(self, stamp_ns: int, right_stamp_ns: int, now_ns: int) -> None:
        """A pair was sent; outputs of the right image alone may have its stamp."""
        pair = _Outstanding(stamp_ns, now_ns, now_ns, set(self._topics))
        self._outstanding[stamp_ns] = self._outstanding[right_stamp_ns] = pair

    def sent_again(self, stamp_ns: int, now_ns: int) -> None:
        """An outstanding pair was sent once more: latencies count from now, the timeout from the first time."""
        self._outstanding[stamp_ns].last_sent_ns = now_ns

    def received(self, topic: str, stamp_ns: int, now_ns: int) -> bool:
        """An output arrived; False where no pair waits for it."""
        pair = self._outstanding.get(stamp_ns)
        if pair is None or topic not in pair.missing:
            return False
        pair.missing.discard(topic)
        self._topics[topic].received += 1
        self._topics[topic].latencies_ms.append((now_ns - pair.last_sent_ns) / 1e6)
        if not pair.missing:
            self._forget(pair)
        return True

    def give_up(self, sent_before_ns: int) -> list[LostPair]:
        """Count the missing outputs of the pairs sent before that time as lost, and stop waiting for them."""
        overdue = {id(pair): pair for pair in self._outstanding.values() if pair.sent_ns < sent_before_ns}
        lost = []
        for pair in overdue.values():
            for topic in pair.missing:
                self._topics[topic].lost += 1
            self._forget(pair)
            lost.append(LostPair(pair.stamp_ns, tuple(sorted(pair.missing)), len(pair.missing) == len(self._topics)))
        return lost

    def stats(self) -> dict[str, OutputStats]:
        """Counts and latencies so far, per topic."""
        return {
            name: OutputStats(topic.received, topic.lost, tuple(topic.latencies_ms))
            for name, topic in self._topics.items()
        }

    def _forget(self, pair: _Outstanding) -> None:
        self._outstanding = {stamp: other for stamp, other in self._outstanding.items() if other is not pair}

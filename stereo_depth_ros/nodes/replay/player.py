# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sends the pairs of a bag into the graph, each when the graph is ready for it, and collects the outputs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from stereo_depth_ros.bags.pairs import BagPairs, SerializedPair
from stereo_depth_ros.core.errors import GraphError
from stereo_depth_ros.messages.cdr import stamp_text
from stereo_depth_ros.nodes.replay.graph_ports import GraphPorts
from stereo_depth_ros.nodes.replay.tracker import LostPair, PairTracker
from stereo_depth_ros.offline.report import OutputStats
from stereo_depth_ros.replay.options import ReplayOptions

__all__ = ["Player"]

_GRAPH_TIMEOUT_S = 20.0
_SETTLED_S = 0.5  # endpoints appear one after the other; after this time without a new one the graph is complete
_LOST_AFTER_S = 10.0
_LAST_AFTER_S = 2.0  # in real time, an output missing this long after the last pair was dropped
_REPEAT_S = 2.0
_MOST_SILENT_PAIRS = 3  # pairs in a row without any output; each takes ten seconds
_SPIN_S = 0.05


class Player:
    """Plays one bag once; :meth:`play` does everything.

    Args:
        ports: publishers, subscriptions and the executor.
        pairs: the open bag.
        options: how to play.
        approximate: the nodes pair different stamps.
        check: called many times a second while waiting; raises when a node has ended.

    Attributes:
        sent: pairs sent.
        wall_s: from the first pair sent to the last output received, seconds.
        lost: pairs whose outputs are incomplete.
    """

    def __init__(
        self, ports: GraphPorts, pairs: BagPairs, options: ReplayOptions, approximate: bool, check: Callable[[], None]
    ) -> None:
        self._ports = ports
        self._pairs = pairs
        self._options = options
        self._needs_followers = approximate  # a node may need the next two images to know the closest one
        self._in_flight = max(options.in_flight, 3) if approximate else options.in_flight
        self._check = check
        self._tracker = PairTracker(ports.output_topics)
        self._silent_pairs = 0
        self._first_ns = self._last_ns = 0
        self.sent = 0
        self.lost: list[LostPair] = []
        ports.on_output = self._on_output

    @property
    def wall_s(self) -> float:
        """Seconds from the first pair sent to the last output received."""
        return (self._last_ns - self._first_ns) / 1e9

    @property
    def stats(self) -> dict[str, OutputStats]:
        """Counts and latencies per output."""
        return self._tracker.stats()

    def play(self, progress: Callable[[int, int], None]) -> None:
        """Wait for the graph, send every pair, wait for the last outputs.

        Args:
            progress: called with pairs sent and pairs to send (at most) after each pair.

        Raises:
            GraphError: a topic without subscriber or publisher, or with a second publisher; pairs without any output.
            BagError: the bag is damaged where it is read.
        """
        self._wait_for_graph()
        start_ns, first_stamp_ns = time.monotonic_ns(), None
        for pair in self._rounds():
            first_stamp_ns = pair.stamp_ns if first_stamp_ns is None else first_stamp_ns
            self._wait_until_due(start_ns, pair.stamp_ns - first_stamp_ns)
            if not self._options.realtime:
                self._wait_for_outputs(self._in_flight - 1)
            self._send(pair)
            if self.sent == 1 and self._proves_links:
                self._repeat_first(pair)
            progress(self.sent, max(self.sent, self._options.loop * self._pairs.count))
        self._wait_for_outputs(0)

    def _rounds(self) -> Iterator[SerializedPair]:
        """The pairs of all rounds; each round is stamped one interval after the one before."""
        shift_ns = 0
        for _ in range(self._options.loop):
            stamps: list[int] = []
            for pair in self._pairs.pairs():
                stamps.append(pair.stamp_ns)
                yield pair.shifted(shift_ns)
            if not stamps:
                return
            interval_ns = (stamps[-1] - stamps[0]) // (len(stamps) - 1) if len(stamps) > 1 else 10**9
            shift_ns += stamps[-1] - stamps[0] + max(1, interval_ns)

    def _send(self, pair: SerializedPair) -> None:
        self._ports.record_infos(pair)
        self._ports.send_all_but_last(pair)
        now_ns = time.monotonic_ns()
        self._tracker.sent(pair.stamp_ns, pair.right_stamp_ns, now_ns)
        self._ports.send_last(pair)
        self._first_ns = self._first_ns or now_ns
        self.sent += 1

    @property
    def _proves_links(self) -> bool:
        """Whether the first pair must be complete before the second is sent."""
        return not (self._options.realtime or self._needs_followers)

    def _repeat_first(self, pair: SerializedPair) -> None:
        """Send the first pair again, every other second, until its outputs are complete or the timeout is over.

        Best-effort links between the nodes may be established later than everything visible from here, and DDS does
        not repeat messages on them. A node that has the pair already drops the repetition as a duplicate: from the
        second one on, the nodes are without a subscriber before it, and forget what they have received.
        """
        repetitions = 0
        end_ns = self._first_ns + round(1e9 * (_LOST_AFTER_S - _REPEAT_S))
        while self._tracker.pending and time.monotonic_ns() < end_ns:
            repeat_ns = time.monotonic_ns() + round(1e9 * _REPEAT_S)
            while self._tracker.pending and time.monotonic_ns() < repeat_ns:
                self._spin(_SPIN_S)
            if self._tracker.pending:
                repetitions += 1
                if repetitions > 1:
                    self._ports.subscribe_again()
                    self._wait_for_graph()
                self._ports.send_all_but_last(pair)
                self._first_ns = time.monotonic_ns()
                self._tracker.sent_again(pair.stamp_ns, self._first_ns)
                self._ports.send_last(pair)

    def _on_output(self, topic: str, stamp_ns: int, now_ns: int) -> bool:
        expected = self._tracker.received(topic, stamp_ns, now_ns)
        if expected:
            self._last_ns = now_ns
            self._silent_pairs = 0
        return expected

    def _wait_until_due(self, start_ns: int, bag_time_ns: int) -> None:
        if self._options.speed:
            due_ns = start_ns + round(bag_time_ns / self._options.speed)
            while (left_s := (due_ns - time.monotonic_ns()) / 1e9) > 0:
                self._spin(left_s)

    def _wait_for_outputs(self, allowed: int) -> None:
        """Wait until at most ``allowed`` pairs are outstanding; late outputs are lost."""
        timeout_s = _LAST_AFTER_S if self._options.realtime else _LOST_AFTER_S
        while self._tracker.pending > allowed:
            self._spin(_SPIN_S)
            for pair in self._tracker.give_up(time.monotonic_ns() - round(1e9 * timeout_s)):
                self._on_lost(pair)

    def _on_lost(self, pair: LostPair) -> None:
        self.lost.append(pair)
        if self._options.realtime:
            return
        reason = self._ports.errors_reported() or "the nodes report no error"
        missing = ", ".join(pair.topics)
        self._ports.warn(f"pair {stamp_text(pair.stamp_ns)}: no {missing} within {_LOST_AFTER_S:g} s: {reason}")
        self._silent_pairs += pair.without_output
        if self._silent_pairs >= _MOST_SILENT_PAIRS:
            raise GraphError(
                f"no output for {self._silent_pairs} pairs in a row, {_LOST_AFTER_S:g} s each",
                value=self._silent_pairs,
                limit=_MOST_SILENT_PAIRS,
                remedy=reason,
            )

    def _wait_for_graph(self) -> None:
        end = time.monotonic() + _GRAPH_TIMEOUT_S
        settled_at, endpoints = time.monotonic() + _SETTLED_S, -1
        while True:
            self._spin(_SPIN_S)
            now, before, obstacles = time.monotonic(), endpoints, self._ports.obstacles()
            endpoints = self._ports.count_endpoints()
            if obstacles or endpoints != before:
                settled_at = now + _SETTLED_S
            if obstacles and now > end:
                raise GraphError(
                    f"{'; '.join(obstacles)} after {_GRAPH_TIMEOUT_S:g} s",
                    limit=_GRAPH_TIMEOUT_S,
                    remedy="run one graph, in the same namespace, in a separate ROS_DOMAIN_ID without cameras or other "
                    "graphs",
                )
            if not obstacles and (now > settled_at or now > end):
                return

    def _spin(self, timeout_s: float) -> None:
        self._check()
        self._ports.spin(min(timeout_s, _SPIN_S))

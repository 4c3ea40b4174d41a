# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node: counters, throttled error messages, stage timings, and a DiagnosticArray every second."""

from __future__ import annotations

import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.nodes.faults import QUIET_S, Faults
from stereo_depth_ros.nodes.log import log_error, log_warning
from stereo_depth_ros.nodes.parameters import error_text

__all__ = ["NodeDiagnostics"]

_WINDOW = 100  # frames of the percentiles of timings


class NodeDiagnostics:
    """Counters and errors of a node; reported errors do not end the node.

    Args:
        node: logs and publishes.

    Attributes:
        counters: by name.
        facts: further values to publish, by name.
        warning: what is wrong though the node works; empty where nothing is.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._turn = threading.RLock()  # errors and timings come from several threads
        self.counters: Counter[str] = Counter()
        self.facts: dict[str, str] = {}
        self.warning = ""
        self._timings_ms: dict[str, deque[float]] = {}
        self._faults = Faults()
        self._losses: dict[str, tuple[Callable[[], int], Callable[[], str]]] = {}
        self._losses_before: Counter[str] = Counter()  # as published last
        self._losses_said: Counter[str] = Counter()  # as logged last
        self._loss_at = self._loss_said_at = -QUIET_S
        self._last_loss = ""
        self._states: list[Callable[[], str]] = []
        self._facts_now: list[Callable[[], Mapping[str, str]]] = []
        self._states_said: set[str] = set()
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # A steady clock: diagnostics continue while simulated time stands still.
        node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def report_error(self, kind: str, text: str, fault: str = "") -> None:
        """Count ``kind``, and log the text: the first one of a fault at once, then one in five seconds.

        Args:
            kind: name of the counter.
            text: what is wrong.
            fault: what tells faults of this kind apart, see :meth:`Faults.report`.
        """
        with self._turn:
            self.counters[kind] += 1
            line = self._faults.report(f"{kind} {fault}", text)
        if line:
            log_error(self._node.get_logger(), line)

    def watch_loss(self, name: str, cause: Callable[[], str], count: Callable[[], int] | None = None) -> None:
        """While a count grows the level is WARN, and its growth is logged with the likely cause and the remedy.

        Args:
            name: of what is counted.
            cause: the cause and the remedy.
            count: the count; None is the counter of that name.
        """
        self._losses[name] = count or (lambda: self.counters[name]), cause

    def watch_state(self, text: Callable[[], str]) -> None:
        """While ``text`` is not empty the level is WARN; it is logged when it appears."""
        self._states.append(text)

    def watch_facts(self, facts: Callable[[], Mapping[str, str]]) -> None:
        """Values to publish, by name, computed when they are."""
        self._facts_now.append(facts)

    @contextmanager
    def catch(self) -> Iterator[None]:
        """Reports exceptions raised in the block, so that no message ends the node."""
        try:
            yield
        except StereoDepthError as error:
            kind, *wider = (each.__name__ for each in type(error).__mro__ if issubclass(each, StereoDepthError))
            self.counters.update(wider[:-1])  # of an ImageError that has a class of its own too
            self.report_error(kind, error_text(error), f"{error.subject}: {error.problem}")
        except Exception as error:  # the boundary of the node
            if not self._node.context.ok():
                return  # the node is shutting down: publishers are gone
            fault = f"unexpected {type(error).__name__}: {error}"
            self.report_error("unexpected", f"{fault}\n{traceback.format_exc()}", fault)

    def timing(self, timings_ms: dict[str, float]) -> None:
        """Add the times of the stages of one frame, ms."""
        with self._turn:
            for stage, ms in timings_ms.items():
                self._timings_ms.setdefault(stage, deque(maxlen=_WINDOW)).append(ms)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Time the block as a stage."""
        start = time.perf_counter()
        yield
        self.timing({stage: 1e3 * (time.perf_counter() - start)})

    def publish(self) -> None:
        """Publish counters and timings on /diagnostics."""
        with self._turn:
            message = self._message()
        self._publisher.publish(message)

    def _message(self) -> DiagnosticArray:
        self._check_losses()
        now = {name: value for facts in self._facts_now for name, value in facts().items()}
        values = {**self.facts, **now, **{name: str(count) for name, count in sorted(self.counters.items())}}
        for stage, times in self._timings_ms.items():
            p50, p95 = np.percentile(np.array(times), (50, 95))
            values |= {f"{stage} p50 ms": f"{p50:.3f}", f"{stage} p95 ms": f"{p95:.3f}"}
        faults = self._faults.present()
        lasting = self._last_loss if time.monotonic() - self._loss_at < QUIET_S else self.warning
        warning = "; ".join(filter(None, (*self._current_states(), lasting)))
        healthy = DiagnosticStatus.WARN if warning else DiagnosticStatus.OK
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if faults else healthy,
            name=self._node.get_fully_qualified_name(),
            message="; ".join(faults) or warning or "ok",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def _current_states(self) -> list[str]:
        """What the states say now; logged where it is new."""
        states = [said for state in self._states if (said := state())]
        for said in states:
            if said not in self._states_said:
                log_warning(self._node.get_logger(), said)
        self._states_said = set(states)
        return states

    def _check_losses(self) -> None:
        """Note what was lost since the last time; log it at most once in five seconds."""
        now, losses = time.monotonic(), Counter({name: count() for name, (count, _) in self._losses.items()})
        if losses - self._losses_before:
            self._loss_at = now
        self._losses_before = losses
        if (grown := losses - self._losses_said) and now - self._loss_said_at >= QUIET_S:
            self._losses_said, self._loss_said_at = losses, now
            causes = dict.fromkeys(self._losses[name][1]() for name in grown)
            counts = ", ".join(f"{count} {name} ({losses[name]} in all)" for name, count in grown.items())
            self._last_loss = f"{counts}: {'; '.join(causes)}"
            log_warning(self._node.get_logger(), self._last_loss)

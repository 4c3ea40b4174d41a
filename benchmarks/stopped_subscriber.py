# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a stopped reliable subscriber of points2 costs: send time of the node, latency and losses of a healthy one.

python benchmarks/stopped_subscriber.py
python benchmarks/stopped_subscriber.py --frames 300 --rate 15
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from graph import Harness, graph_processes
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from stereo_depth_ros.nodes.transport import PROFILE_VARIABLES
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

__all__ = ["main"]

SIZE = (640, 480)
WINDOW = 100  # frames of the percentiles on /diagnostics
TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Row:
    """What was measured with one state of the other subscriber."""

    state: str
    send_ms: tuple[float, float]
    latencies_ms: list[float]
    lost: int

    def __str__(self) -> str:
        median, late = np.percentile(self.latencies_ms or [np.nan], (50, 95))
        return (
            f"{self.state:>21} {self.send_ms[0]:12.1f} {self.send_ms[1]:8.1f} {median:12.1f} {late:8.1f} {self.lost:6d}"
        )


class Diagnostics:
    """The newest values of the fused node on /diagnostics."""

    def __init__(self, harness: Harness) -> None:
        self.values: dict[str, str] = {}
        harness.node.create_subscription(DiagnosticArray, "/diagnostics", self._receive, 10)

    def _receive(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/stereo_depth_node":
                self.values = {item.key: item.value for item in status.values}

    def send_ms(self) -> tuple[float, float]:
        """Median and 95th percentile of the time to send a cloud, ms."""
        return float(self.values["send points2 p50 ms"]), float(self.values["send points2 p95 ms"])


@contextmanager
def subscriber(profile: bool = True) -> Iterator[subprocess.Popen[bytes]]:
    """A process that reliably subscribes points2 and does nothing else, with the Fast DDS profile or without any."""
    environment = {name: value for name, value in os.environ.items() if profile or name not in PROFILE_VARIABLES}
    process = subprocess.Popen([sys.executable, __file__, "--subscribe"], env=environment)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()


def subscribe() -> None:
    """The program of that process."""
    rclpy.init()
    node = rclpy.create_node("other_subscriber")
    node.create_subscription(PointCloud2, "points2", lambda _: None, QoSProfile(depth=10), raw=True)
    rclpy.spin(node)


def wait(harness: Harness, condition: Callable[[], object], timeout_s: float) -> bool:
    """Receive until the condition or the timeout; whether it was the condition."""
    end = time.monotonic() + timeout_s
    while not condition():
        if (left := end - time.monotonic()) <= 0:
            return False
        harness.spin_once(left)
    return True


def measure(harness: Harness, diagnostics: Diagnostics, state: str, frames: int, rate_hz: float) -> Row:
    """Send pairs at a rate; time each cloud that comes before the next pair is due twice over."""
    latencies_ms, lost, due = [], 0, time.monotonic()
    for _ in range(frames):
        wait(harness, lambda: False, due - time.monotonic())
        due = max(due + 1 / rate_hz, time.monotonic())
        before, start = harness.received["points2"], time.perf_counter()
        harness.send(harness.messages())
        if wait(harness, lambda: harness.received["points2"] > before, 2.0):  # noqa: B023
            latencies_ms.append(1e3 * (time.perf_counter() - start))
        else:
            lost += 1
    wait(harness, lambda: False, 2.0)  # for the next diagnostics
    return Row(state, diagnostics.send_ms(), latencies_ms, lost)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=2 * WINDOW)
    parser.add_argument("--rate", type=float, default=15.0, help="pairs per second")
    parser.add_argument("--subscribe", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.subscribe:
        subscribe()
        return
    rclpy.init()
    with graph_processes("fused", "bm", 64):
        harness = Harness(SyntheticSequence(frames=1, width=SIZE[0], height=SIZE[1]), typed=False)
        diagnostics = Diagnostics(harness)
        harness.wait_for_graph()
        print("                other  send p50 ms   p95 ms   latency ms   p95 ms   lost")
        print(measure(harness, diagnostics, "none", options.frames, options.rate), flush=True)
        for profile in (True, False):
            with subscriber(profile) as process:
                wait(harness, lambda: harness.node.count_subscribers("points2") > 1, TIMEOUT_S)
                for state, number in (("running", None), ("stopped", signal.SIGSTOP), ("continued", signal.SIGCONT)):
                    if number is not None:
                        process.send_signal(number)
                    name = state if profile else f"{state}, no profile"
                    print(measure(harness, diagnostics, name, options.frames, options.rate), flush=True)
        harness.close()
    rclpy.shutdown()


if __name__ == "__main__":
    main()

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time from the start of a node after kill -9 until it is ready, connected to its camera, and sends its first cloud.

A camera of 20 Hz and a subscriber of the cloud, this process, stay alive. Kernels are compiled before.

    python benchmarks/restart.py --starts 10
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable

import numpy as np
import rclpy
from graph import NODES, Harness, graph_processes
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int64

from stereo_depth_ros.synthetic.sequence import SyntheticSequence

PERIOD_S = 0.05
LIMIT_S = 30.0


class Restarts(Harness):
    """The camera and the subscriber, and when they saw what."""

    def __init__(self, sequence: SyntheticSequence, shape: str) -> None:
        super().__init__(sequence, typed=False)
        self._nodes = NODES[shape]
        self._ready: set[int] = set()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for node in self._nodes:
            self.node.create_subscription(Int64, f"/{node}/ready", lambda m: self._ready.add(m.data), latched)

    def times_s(self, pids: set[int], start: float) -> list[float]:
        """Until all are ready, until they have subscribed to both images, and until the first cloud, seconds."""
        clouds, events = self.received["points2"], []
        steps: list[Callable[[], object]] = [
            lambda: pids <= self._ready,
            lambda: all(self.publishers[f"{side}/image_raw"].get_subscription_count() for side in ("left", "right")),
            lambda: self.received["points2"] > clouds,
        ]
        for step in steps:
            self._until(step, start)
            events.append(time.monotonic() - start)
        return events

    def wait_until_gone(self) -> None:
        """Until DDS has forgotten the killed nodes; one that starts before would share their topics with them."""
        self._until(lambda: not self.publishers["left/image_raw"].get_subscription_count(), time.monotonic())

    def _until(self, condition: Callable[[], object], start: float) -> None:
        sent_at = time.monotonic()
        while not condition():
            if time.monotonic() - start > LIMIT_S:
                raise TimeoutError(f"nothing within {LIMIT_S:g} s")
            if time.monotonic() >= sent_at + PERIOD_S:
                sent_at += PERIOD_S
                self.send(self.messages())
            self.spin_once(0.005)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--shape", choices=list(NODES), default="fused")
    options = parser.parse_args()
    rclpy.init()
    harness = Restarts(SyntheticSequence(frames=1), options.shape)
    rows = []
    print("   ready s  connected s  first cloud s  CPU s of a node")
    for number in range(options.starts + 1):
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        start = time.monotonic()
        with graph_processes(options.shape, "bm", 64) as processes:
            times = harness.times_s({process.pid for process in processes}, start)
            for process in processes:
                process.kill()
        harness.wait_until_gone()
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = (now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime) / len(processes)
        if number:  # the first one may compile kernels
            rows.append((*times, cpu_s))
            print("{:10.2f} {:12.2f} {:14.2f} {:16.2f}".format(*rows[-1]), flush=True)
    print("{:10.2f} {:12.2f} {:14.2f} {:16.2f}  median".format(*np.median(rows, axis=0)))
    harness.close()
    rclpy.shutdown()


if __name__ == "__main__":
    main()

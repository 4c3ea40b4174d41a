# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Thousands of frames through the graph: memory of its nodes over time, and lost frames.

Frames are sent one after the other, or at a fixed rate, whatever is still on the way.

    python benchmarks/soak.py
    python benchmarks/soak.py --shape separate --rate 20 --frames 36000
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import rclpy
from graph import NODES, Harness, graph_processes

from stereo_depth_ros.synthetic.sequence import SyntheticSequence

REPORTS = 20
LAST_S = 10.0  # for the last frames on the way


def resident_mib(pid: int) -> float:
    """Resident memory of a process without shared-memory segments, MiB."""
    status = Path(f"/proc/{pid}/status").read_text()
    fields = dict(line.split(":", 1) for line in status.splitlines())
    return int(fields["RssAnon"].split()[0]) / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--shape", choices=list(NODES), default="fused")
    parser.add_argument("--rate", type=float, default=0.0, help="frames a second; 0 sends one after the other")
    options = parser.parse_args()
    rclpy.init()
    with graph_processes(options.shape, "bm", 64) as processes:
        harness = Harness(SyntheticSequence(frames=1), typed=False)
        harness.wait_for_graph()
        first = dict(harness.received)
        print(f"  frame  clouds disparities  MiB of {', '.join(NODES[options.shape])}")
        start = time.monotonic()
        for frame in range(1, options.frames + 1):
            harness.send(harness.messages())
            if options.rate:
                while time.monotonic() < start + frame / options.rate:
                    harness.spin_once(min(0.1, max(0.0, start + frame / options.rate - time.monotonic())))
            else:
                harness.wait(min(first.values()) + frame)
            if frame == 500 or frame % (options.frames // REPORTS) == 0:
                _report(frame, harness, first, [process.pid for process in processes])
        harness.wait(min(first.values()) + options.frames, LAST_S)
        _report(options.frames, harness, first, [process.pid for process in processes])
        harness.close()
    rclpy.shutdown()


def _report(frame: int, harness: Harness, first: dict[str, int], pids: list[int]) -> None:
    clouds, disparities = (harness.received[topic] - first[topic] for topic in ("points2", "disparity"))
    memory = "  ".join(f"{resident_mib(pid):.1f}" for pid in pids)
    print(f"{frame:7d} {clouds:7d} {disparities:11d}  {memory}", flush=True)


if __name__ == "__main__":
    main()

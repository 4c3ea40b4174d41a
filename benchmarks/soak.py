# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ten thousand frames through stereo_depth_node: memory of the node over time, and lost frames.

python benchmarks/soak.py
python benchmarks/soak.py --frames 2000
"""

from __future__ import annotations

import argparse
from pathlib import Path

import rclpy
from graph import Harness, graph_processes

from stereo_depth_ros.synthetic.sequence import SyntheticSequence

REPORTS = 20


def resident_mib(pid: int) -> float:
    """Resident memory of a process without shared-memory segments, MiB."""
    status = Path(f"/proc/{pid}/status").read_text()
    fields = dict(line.split(":", 1) for line in status.splitlines())
    return int(fields["RssAnon"].split()[0]) / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=10_000)
    options = parser.parse_args()
    rclpy.init()
    with graph_processes("fused", "bm", 64) as processes:
        harness = Harness(SyntheticSequence(frames=1), typed=False)
        harness.wait_for_graph()
        lost = 0
        print("  frame  node MiB   lost")
        for frame in range(1, options.frames + 1):
            before = min(harness.received.values())
            harness.send(harness.messages())
            lost += not harness.wait(before + 1)
            if frame == 500 or frame % (options.frames // REPORTS) == 0:
                print(f"{frame:7d} {resident_mib(processes[0].pid):9.1f} {lost:6d}", flush=True)
        harness.close()
    rclpy.shutdown()


if __name__ == "__main__":
    main()

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A camera driver with nothing set, neither transport nor QoS: how many of its pairs become clouds, and what is said.

The driver is a process of its own with the transport as installed: reliable publishers of depth 10, as rclcpp's and
rclpy's default. It begins to publish as soon as all nodes have subscribed.

    python benchmarks/stock_camera.py
    python benchmarks/stock_camera.py --shapes separate --runs 6
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph import NODES, Camera, graph_processes
from sensor_msgs.msg import PointCloud2

from stereo_depth_ros.nodes.transport import PROFILE_VARIABLES
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

SETUPS = ((640, 480, 15.0, 45), (1280, 720, 5.0, 30))  # width, height, frames a second, frames
AFTER_S = 5.0  # for the last pairs on the way
TIMEOUT_S = 60.0
STOCK = {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT", "STEREO_DEPTH_MALLOPT": "0"}  # prepare_process then sets nothing


def drive(width: int, height: int, rate_hz: float, frames: int, nodes: int) -> None:
    """Publish the pairs; the driver's process runs this."""
    rclpy.init()
    driver = Camera(SyntheticSequence(frames=1, width=width, height=height))
    driver.wait_for_subscribers(of_infos=nodes)
    start = time.monotonic()
    for number in range(frames):
        time.sleep(max(0.0, start + number / rate_hz - time.monotonic()))
        driver.send(driver.messages())
    time.sleep(AFTER_S)


@contextmanager
def driver(*arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    """The process of the driver, without the settings of this one."""
    environment = {name: value for name, value in os.environ.items() if name not in PROFILE_VARIABLES}
    process = subprocess.Popen([sys.executable, __file__, "--camera", *map(str, arguments)], env=environment | STOCK)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def measure(shape: str, setup: tuple[int, int, float, int]) -> str:
    """One run: a row of the table, and below it what the nodes said."""
    width, height, rate_hz, frames = setup
    node = rclpy.create_node("user")
    clouds: list[object] = []
    said: dict[str, str] = {}

    def note(array: DiagnosticArray) -> None:
        for status in array.status:
            if status.level == DiagnosticStatus.WARN:
                said[status.name] = status.message

    node.create_subscription(PointCloud2, "points2", clouds.append, 100, raw=True)
    node.create_subscription(DiagnosticArray, "/diagnostics", note, 100)
    with graph_processes(shape, "bm", 64), driver(width, height, rate_hz, frames, len(NODES[shape])) as process:
        deadline = time.monotonic() + TIMEOUT_S + frames / rate_hz
        while process.poll() is None and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    lines = [f"{shape:>9} {width}x{height} {rate_hz:4.0f} Hz  {len(clouds):3d} of {frames} clouds"]
    return "\n".join(lines + [f"          {name}: {text}" for name, text in said.items()])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", nargs="+", default=list(NODES), choices=list(NODES))
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--camera", nargs=5, type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.camera:
        width, height, rate_hz, frames, nodes = options.camera
        drive(int(width), int(height), rate_hz, int(frames), int(nodes))
        return
    rclpy.init()
    for shape in options.shapes:
        for setup in SETUPS:
            for _ in range(options.runs):
                print(measure(shape, setup), flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()

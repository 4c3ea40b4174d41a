# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Latency and throughput of the graph, from raw pair published to PointCloud2 received, compared with the bare kernels.

This process publishes raw pairs and receives clouds and disparities; each node runs in a separate process. The bare
kernels (two remaps, matcher and reprojection, those of OpenCV if available, with all threads) are timed between frames.
First one pair is in flight at a time; then several, for the rate, also in units of the rate of the kernels, and the
latency at that rate: so many pairs are always on the way, so it is not below their number divided by the rate.

    python benchmarks/graph.py
    python benchmarks/graph.py --shapes fused --matchers bm --frames 100
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
from typing import ClassVar

import cv2
import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import U8, StereoPair
from stereo_depth_ros.matching import MATCHERS, create_matcher
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.sgm.semi_global_block_matching import penalties
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes.transport import prepare_process
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

os.environ.setdefault("ROS_DOMAIN_ID", "93")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
prepare_process()

import rclpy  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, PointCloud2  # noqa: E402
from stereo_msgs.msg import DisparityImage  # noqa: E402

SIZES = ((640, 480, 64), (1280, 720, 128))
NODES = {
    "fused": ("stereo_depth_node",),
    "separate": ("rectify_node", "disparity_node", "point_cloud_node"),
}
QUALITIES = {"sgm": "default", "sgm-fast": "fast", "sgm-best": "best"}
TIMEOUT_S = 20.0


@dataclass
class Row:
    """The results of one combination of size, matcher and processes."""

    size: str
    matcher: str
    shape: str
    kernels_ms: float
    latency_ms: float
    p95_ms: float
    disparity_ms: float
    fps: float
    overlapped_ms: float
    lost: int

    HEADER: ClassVar[str] = (
        "          size   alg     shape  kernels ms  latency ms   p95 ms  ratio  disparity ms  frames/s  x kernels  "
        "in flight ms  lost"
    )

    def __str__(self) -> str:
        return (
            f"{self.size:>14} {self.matcher:>8} {self.shape:>9} {self.kernels_ms:11.1f} {self.latency_ms:11.1f} "
            f"{self.p95_ms:8.1f} {self.latency_ms / self.kernels_ms:6.2f} {self.disparity_ms:13.1f} {self.fps:9.1f} "
            f"{self.fps * self.kernels_ms / 1e3:10.2f} {self.overlapped_ms:13.1f} {self.lost:5d}"
        )


class Camera:
    """Publishes the serialized first pair of a sequence again and again, with new stamps."""

    def __init__(self, sequence: SyntheticSequence) -> None:
        self._types = RosbagsTypes()
        self._rig = sequence.rig
        self._pair = sequence[0].pair
        self.node = rclpy.create_node("benchmark")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self.publishers = {
            topic: self.node.create_publisher(kind, topic, qos)
            for topic, kind in (
                ("left/camera_info", CameraInfo),
                ("right/camera_info", CameraInfo),
                ("left/image_raw", Image),
                ("right/image_raw", Image),
            )
        }
        self._stamp_ns = 1_000_000_000

    def messages(self) -> dict[str, bytes]:
        """The serialized messages of the next pair by topic."""
        self._stamp_ns += 1_000_000
        types, stamp = self._types, self._stamp_ns
        left, right = self._pair.left, self._pair.right
        return {
            "left/camera_info": types.serialize(camera_info_message(types, self._rig.left, stamp)),
            "right/camera_info": types.serialize(camera_info_message(types, self._rig.right, stamp)),
            "left/image_raw": types.serialize(image_message(types, left.pixels, "mono8", stamp, left.frame_id)),
            "right/image_raw": types.serialize(image_message(types, right.pixels, "mono8", stamp, right.frame_id)),
        }

    def send(self, messages: dict[str, bytes]) -> None:
        for topic, data in messages.items():
            self.publishers[topic].publish(data)

    def wait_for_subscribers(self, of_infos: int = 1) -> None:
        """Wait until all topics have a subscriber, the camera infos so many."""
        deadline = time.monotonic() + TIMEOUT_S
        wanted = {topic: of_infos if topic.endswith("camera_info") else 1 for topic in self.publishers}
        while missing := [t for t, p in self.publishers.items() if p.get_subscription_count() < wanted[t]]:
            if time.monotonic() > deadline:
                raise TimeoutError(f"no subscriber of {missing} within {TIMEOUT_S:g} s")
            self.spin_once()

    def spin_once(self, timeout_s: float = 0.1) -> None:
        self._executor.spin_once(timeout_sec=timeout_s)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()


class Harness(Camera):
    """A camera that counts the received outputs."""

    def __init__(self, sequence: SyntheticSequence, typed: bool) -> None:
        super().__init__(sequence)
        self.received = {"points2": 0, "disparity": 0}
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        for topic, kind in (("points2", PointCloud2), ("disparity", DisparityImage)):
            self.node.create_subscription(kind, topic, self._receiver(topic), qos, raw=not typed)

    def _receiver(self, topic: str) -> Callable[[object], None]:
        def receive(_: object) -> None:
            self.received[topic] += 1

        return receive

    def wait_for_graph(self) -> None:
        deadline = time.monotonic() + TIMEOUT_S
        self.wait_for_subscribers()
        # Best-effort messages are lost until both ends of a connection have discovered each other: retry until then.
        while not self.wait(1, timeout_s=2.0):
            if time.monotonic() > deadline:
                raise TimeoutError(f"no cloud and disparity within {TIMEOUT_S:g} s")
            self.send(self.messages())
        self.wait(sys.maxsize, timeout_s=1.0)  # receive the outputs of the retries

    def wait(self, count: int, timeout_s: float = TIMEOUT_S) -> bool:
        """Wait for that many clouds and disparities; False after the timeout."""
        deadline = time.monotonic() + timeout_s
        while min(self.received.values()) < count and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.1)
        return min(self.received.values()) >= count


def bare_kernels(pair: StereoPair, matcher: str, disparities: int) -> Callable[[], float]:
    """A function that runs two remaps, the matcher and the reprojection, and returns the time, milliseconds."""
    height, width = pair.left.pixels.shape
    K = np.array([[width * 0.9, 0, width / 2], [0, width * 0.9, height / 2], [0, 0, 1.0]])
    maps = cv2.initUndistortRectifyMap(
        K, np.array([0.1, -0.05, 0, 0, 0]), np.identity(3), K, (width, height), cv2.CV_16SC2
    )
    Q = np.array([[1, 0, 0, -width / 2], [0, 1, 0, -height / 2], [0, 0, 0, width * 0.9], [0, 0, 8.0, 0]])
    left, right = np.empty((2, height, width), np.uint8)
    disparity_x16 = np.empty((height, width), np.int16)
    match = _bare_matcher(matcher, disparities, disparity_x16)
    disparity = np.empty((height, width), np.float32)
    points = np.empty((height, width, 3), np.float32)

    def run() -> float:
        start = time.perf_counter()
        cv2.remap(pair.left.pixels, maps[0], maps[1], cv2.INTER_LINEAR, left)
        cv2.remap(pair.right.pixels, maps[0], maps[1], cv2.INTER_LINEAR, right)
        match(pair.left.pixels, pair.right.pixels)
        middle = time.perf_counter()
        np.multiply(disparity_x16, np.float32(1 / 16), out=disparity)
        again = time.perf_counter()
        cv2.reprojectImageTo3D(disparity, Q, points)
        return 1e3 * (time.perf_counter() - again + middle - start)

    return run


def _bare_matcher(matcher: str, disparities: int, disparity_x16: I16) -> Callable[[U8, U8], object]:
    """The matcher of OpenCV if it has one, with the default parameters of the nodes."""
    if matcher in QUALITIES:
        return create_matcher("sgm", num_disparities=disparities, quality=QUALITIES[matcher]).match
    stereo = _opencv_matcher(matcher, disparities)
    return lambda left, right: stereo.compute(left, right, disparity_x16)


def _opencv_matcher(matcher: str, disparities: int) -> cv2.StereoMatcher:
    if matcher == "sgbm":
        P1, P2 = penalties(MatchingConfig())
        return cv2.StereoSGBM.create(0, disparities, 15, P1, P2, 0, 31, 15, 100, 4)
    block_matching = cv2.StereoBM.create(disparities, 15)
    block_matching.setPreFilterCap(31)
    block_matching.setTextureThreshold(10)
    block_matching.setUniquenessRatio(15)
    block_matching.setSpeckleWindowSize(100)
    block_matching.setSpeckleRange(4)
    return block_matching


@contextmanager
def graph_processes(shape: str, matcher: str, disparities: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """The nodes of a shape, one process each."""
    name = "sgm" if matcher in QUALITIES else matcher
    parameters: dict[str, object] = {"stereo_algorithm": list(MATCHERS).index(name), "disparity_range": disparities}
    parameters |= {"quality": QUALITIES.get(matcher, "default")}
    arguments = [part for name, value in parameters.items() for part in ("-p", f"{name}:={value}")]
    processes = [
        subprocess.Popen([sys.executable, "-m", f"stereo_depth_ros.nodes.{node}", "--ros-args", *arguments])
        for node in NODES[shape]
    ]
    try:
        yield processes
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            process.wait(10)


def measure(size: tuple[int, int, int], matcher: str, shape: str, frames: int, in_flight: int, typed: bool) -> Row:
    width, height, disparities = size
    sequence = SyntheticSequence(frames=1, width=width, height=height)
    kernels = bare_kernels(sequence[0].pair, matcher, disparities)
    with graph_processes(shape, matcher, disparities):
        harness = Harness(sequence, typed)
        try:
            harness.wait_for_graph()
            return _measure(harness, kernels, size, matcher, shape, frames, in_flight)
        finally:
            harness.close()


def _measure(
    harness: Harness,
    kernels: Callable[[], float],
    size: tuple[int, int, int],
    matcher: str,
    shape: str,
    frames: int,
    in_flight: int,
) -> Row:
    latencies: dict[str, list[float]] = {"points2": [], "disparity": []}
    kernel_times, lost = [], 0
    for frame in range(frames + 5):
        messages = harness.messages()
        first = dict(harness.received)
        start = time.perf_counter()
        harness.send(messages)
        arrived: dict[str, float] = {}
        while len(arrived) < 2 and time.perf_counter() - start < TIMEOUT_S:
            harness.spin_once()
            now_ms = 1e3 * (time.perf_counter() - start)
            for topic, count in harness.received.items():
                if count > first[topic]:
                    arrived.setdefault(topic, now_ms)
        lost += len(arrived) < 2
        kernel_time = kernels()
        if frame >= 5:
            kernel_times.append(kernel_time)
            for topic, ms in arrived.items():
                latencies[topic].append(ms)
    fps, overlapped, missing = _measure_rate(harness, frames, in_flight)
    return Row(
        f"{size[0]}x{size[1]}/{size[2]}",
        matcher,
        shape,
        float(np.median(kernel_times)),
        float(np.median(latencies["points2"])),
        float(np.percentile(latencies["points2"], 95)),
        float(np.median(latencies["disparity"])),
        fps,
        overlapped,
        lost + missing,
    )


def _measure_rate(harness: Harness, frames: int, in_flight: int) -> tuple[float, float, int]:
    """Frames per second with so many pairs in flight, the median latency in ms, and 1 where the last did not arrive."""
    batch = [harness.messages() for _ in range(frames)]
    sent_at: list[float] = []
    latencies: list[float] = []
    before = min(harness.received.values())
    start = deadline = time.perf_counter()
    while len(latencies) < frames and time.perf_counter() - deadline < TIMEOUT_S:
        if len(sent_at) < min(frames, len(latencies) + in_flight):
            sent_at.append(time.perf_counter())
            harness.send(batch[len(sent_at) - 1])
            continue
        harness.spin_once()
        while len(latencies) < min(harness.received.values()) - before:
            deadline = time.perf_counter()
            latencies.append(1e3 * (deadline - sent_at[len(latencies)]))
    return len(latencies) / (deadline - start), float(np.median(latencies)), int(len(latencies) < frames)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument(
        "--in-flight", type=int, default=3, help="pairs processed at the same time when measuring the maximum rate"
    )
    parser.add_argument("--shapes", nargs="+", default=list(NODES), choices=list(NODES))
    parser.add_argument("--matchers", nargs="+", default=["bm", "sgbm", "sgm"], choices=["bm", "sgbm", *QUALITIES])
    parser.add_argument("--sizes", nargs="+", type=int, default=[0, 1], choices=[0, 1])
    parser.add_argument("--typed", action="store_true", help="receive deserialized messages instead of bytes")
    options = parser.parse_args()
    rclpy.init()
    print(Row.HEADER)
    for index in options.sizes:
        for matcher in options.matchers:
            for shape in options.shapes:
                row = measure(SIZES[index], matcher, shape, options.frames, options.in_flight, options.typed)
                print(row, flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The signal that a node is ready: late subscribers, log formats, slow starts, nodes that never get ready."""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="graph tests need ROS 2")

import rclpy
from graph_harness import ENVIRONMENT, NodeProcess
from rclpy.context import Context
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int64
from stereo_depth_ros.nodes.replay.live import replay_through_graph

from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.errors import GraphError
from stereo_depth_ros.nodes.readiness import announce_ready, wait_until_ready
from stereo_depth_ros.replay.options import ReplayOptions

pytestmark = pytest.mark.graph

SAMPLE = Path(__file__).resolve().parents[1] / "bags" / "synthetic_room.mcap"


@pytest.fixture(autouse=True)
def own_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)


@pytest.fixture
def node() -> Iterator[rclpy.node.Node]:
    """A node of this process in the same domain."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("slow_node", context=context, enable_rosout=False)
    yield node
    node.destroy_node()
    rclpy.try_shutdown(context=context)


def never() -> None:
    """Every process runs."""


def test_a_late_subscriber_receives_the_number_of_the_process(tmp_path: Path) -> None:
    process = NodeProcess("rectify_node", [], tmp_path)
    context = Context()
    try:
        process.wait_ready()
        rclpy.init(args=[], context=context)
        listener = rclpy.create_node("late", context=context, enable_rosout=False)
        received: list[Int64] = []
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        listener.create_subscription(Int64, "/rectify_node/ready", received.append, qos)
        executor = rclpy.executors.SingleThreadedExecutor(context=context)
        executor.add_node(listener)
        end = time.monotonic() + 15
        while not received and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
        executor.shutdown()
        listener.destroy_node()
        assert [message.data for message in received] == [process.number]
    finally:
        rclpy.try_shutdown(context=context)
        process.kill()


def test_the_graph_starts_with_another_format_of_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{message}")
    options = ReplayOptions(bag=str(SAMPLE), duration_seconds=0.25)
    result = replay_through_graph(options, "fused", {}, PipelineConfig(), lambda done, total: None)
    assert (result.pairs, result.lost) == (3, 0)


def test_a_node_that_makes_progress_is_waited_for_beyond_the_timeout(node: rclpy.node.Node) -> None:
    begin, logged = time.monotonic(), itertools.count()
    timer = threading.Timer(2.0, announce_ready, [node])
    timer.start()
    wait_until_ready({"slow_node": os.getpid()}, lambda: next(logged), never, timeout_s=0.5)
    assert time.monotonic() - begin > 1.5
    timer.join()


def test_the_timeout_counts_from_the_last_progress() -> None:
    begin = time.monotonic()
    with pytest.raises(GraphError):
        wait_until_ready({"slow_node": 1}, lambda: min(time.monotonic(), begin + 1.0), never, timeout_s=0.5)
    assert time.monotonic() - begin == pytest.approx(1.5, abs=0.4)


def test_a_node_that_makes_no_progress_is_named(node: rclpy.node.Node) -> None:
    announce_ready(node)
    processes = {"slow_node": os.getpid(), "stuck_node": 4711}
    with pytest.raises(GraphError, match=r"^stuck_node: not ready, .* nothing has changed for 1 s: read the log"):
        wait_until_ready(processes, lambda: 0, never, timeout_s=1.0)


def test_a_node_of_another_process_does_not_count(node: rclpy.node.Node) -> None:
    announce_ready(node)
    with pytest.raises(GraphError, match="slow_node"):
        wait_until_ready({"slow_node": os.getpid() + 1}, lambda: 0, never, timeout_s=1.0)


def test_a_process_that_ended_ends_the_wait() -> None:
    def ended() -> None:
        raise GraphError("slow_node ended with exit code 1")

    with pytest.raises(GraphError, match="exit code 1"):
        wait_until_ready({"slow_node": 1}, lambda: 0, ended, timeout_s=10.0)

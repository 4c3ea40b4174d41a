# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags through live nodes: every pair once, the bytes of the offline engine, errors of a missing or failed node."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ros_domain import own_number
from stereo_bags import (
    PARAMETERS,
    cut,
    later,
    median_relative_depth_error,
    messages_of,
    sequence,
    write_odd_bag,
    write_truth_bag,
)

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import GraphError, TopicError
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.replay.graph_processes import SHAPES, GraphProcesses
from stereo_depth_ros.replay.options import ReplayOptions

pytestmark = pytest.mark.graph

FRAMES = 4
CONFIG = pipeline_config(PARAMETERS)
IMAGES = ("/left/image_rect", "/left/image_rect_color", "/right/image_rect")
SAME_BYTES = (*IMAGES, "/disparity", "/depth/image_rect", "/points2")
OUTPUTS = (*SAME_BYTES, "/depth/camera_info")


def domain(number: int) -> str:
    """A ROS_DOMAIN_ID that no other run of these tests on this machine is likely to have."""
    return str(20 + 5 * own_number(10) + number)


@pytest.fixture(scope="module", autouse=True)
def own_domain() -> Iterator[None]:
    """A ROS domain of these tests, on this machine only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", domain(0))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "in.mcap"
    write_truth_bag(path, FRAMES)
    return path


@pytest.fixture(scope="module")
def graph(own_domain: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[GraphProcesses]:
    with GraphProcesses("fused", PARAMETERS, tmp_path_factory.mktemp("logs")) as processes:
        yield processes


def write_with_smaller_images(path: Path) -> None:
    """Five pairs; the images of the last three have two rows less than their camera infos."""
    types, made = RosbagsTypes(), sequence(5)
    with BagWriter(path) as writer:
        for index, frame in enumerate(made):
            sides = (("left", frame.pair.left, made.rig.left), ("right", frame.pair.right, made.rig.right))
            for side, image, camera in sides:
                pixels = image.pixels if index < 2 else image.pixels[:-2]
                small = image_message(types, pixels, "mono8", image.stamp_ns, image.frame_id)
                writer.write(f"/{side}/camera_info", camera_info_message(types, camera, image.stamp_ns), image.stamp_ns)
                writer.write(f"/{side}/image_raw", small, image.stamp_ns)


def assert_equal_messages(path: Path, other: Path, topics: tuple[str, ...]) -> None:
    for topic in topics:
        assert messages_of(path, topic) == messages_of(other, topic), f"{topic} differs"


def test_fused_gives_every_pair_once_with_the_bytes_of_the_offline_engine(
    graph: GraphProcesses, bag: Path, tmp_path: Path
) -> None:
    from stereo_depth_ros.nodes.replay_node import replay

    calls: list[tuple[int, int]] = []
    options = ReplayOptions(bag=str(bag), output=str(tmp_path / "live.mcap"))
    result = replay(options, lambda sent, total: calls.append((sent, total)), graph.check, CONFIG)
    process_bag(BagSelection(bag), tmp_path / "offline.mcap", CONFIG)

    assert calls == [(n, FRAMES) for n in range(1, FRAMES + 1)]
    assert (result.pairs, result.lost, result.warnings) == (FRAMES, 0, ())
    assert {stats.received for stats in result.outputs.values()} == {FRAMES}
    assert all(0 < ms < 10_000 for stats in result.outputs.values() for ms in stats.latencies_ms)
    made = sequence(FRAMES)
    for topic in OUTPUTS:
        stamps = list(messages_of(tmp_path / "live.mcap", topic))
        assert stamps == [made.stamp_ns(index) for index in range(FRAMES)], topic
    assert_equal_messages(tmp_path / "live.mcap", tmp_path / "offline.mcap", SAME_BYTES)
    # 1/8 px of the 4 to 8 px that this small rig has at 2 to 4 m is 3 %
    assert median_relative_depth_error(tmp_path / "live.mcap", made) < 0.03
    assert result.score is not None and result.score.truth_frames == FRAMES
    assert result.score.median_px < 0.25
    assert any(stage.endswith(": match") for stage in result.stages_ms)


def test_rounds_of_a_loop_differ_in_their_stamps_only(graph: GraphProcesses, bag: Path, tmp_path: Path) -> None:
    from stereo_depth_ros.nodes.replay_node import replay

    path = later(bag, tmp_path / "in.mcap", seconds=10)
    options = ReplayOptions(bag=str(path), output=str(tmp_path / "loop.mcap"), loop=3, in_flight=2, clock=True)
    result = replay(options, check=graph.check, config=CONFIG)
    assert (result.pairs, result.lost) == (3 * FRAMES, 0)
    found = messages_of(tmp_path / "loop.mcap", "/disparity")
    stamps = sorted(found)
    assert {after - before for before, after in itertools.pairwise(stamps)} == {100_000_000}
    pixels = [found[stamp][-60_000:] for stamp in stamps]  # the bytes before hold the stamp, twice
    assert pixels[:FRAMES] == pixels[FRAMES : 2 * FRAMES] == pixels[2 * FRAMES :]


def test_cut_bag_is_played_to_the_cut_with_a_warning(graph: GraphProcesses, bag: Path, tmp_path: Path) -> None:
    from stereo_depth_ros.nodes.replay_node import replay

    path = cut(later(bag, tmp_path / "whole.mcap", seconds=20), tmp_path / "cut.mcap", 0.6)
    result = replay(ReplayOptions(bag=str(path)), check=graph.check, config=CONFIG)
    assert 1 <= result.pairs < FRAMES
    assert result.lost == 0
    assert result.score is None, "nothing was recorded"
    assert any("cut in the middle" in text for text in result.warnings)


def test_realtime_publishes_at_the_rate(graph: GraphProcesses, bag: Path, tmp_path: Path) -> None:
    from stereo_depth_ros.nodes.replay_node import replay

    path = later(bag, tmp_path / "in.mcap", seconds=30)
    options = ReplayOptions(bag=str(path), realtime=True, rate=0.5, duration_seconds=0.25)
    result = replay(options, check=graph.check, config=CONFIG)
    assert result.pairs == 3
    # the third pair is due 0.2 s / 0.5 after the first
    assert 0.4 <= result.wall_s < 3.0


def test_replay_node_plays_with_ros_parameters_and_ends_with_0(
    graph: GraphProcesses, bag: Path, tmp_path: Path
) -> None:
    path, output = later(bag, tmp_path / "in.mcap", seconds=40), tmp_path / "node.mcap"
    command = [sys.executable, "-m", "stereo_depth_ros.nodes.replay_node", "--ros-args"]
    command += ["-p", f"bag:={path}", "-p", f"output:={output}", "-p", "duration_seconds:=0.15"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "2 pairs of" in done.stderr
    assert len(messages_of(output, "/points2")) == 2


def test_replay_node_without_a_bag_is_an_error() -> None:
    command = [sys.executable, "-m", "stereo_depth_ros.nodes.replay_node"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "parameter bag is empty" in done.stderr


def test_separate_nodes_give_the_bytes_of_the_offline_engine_from_a_compressed_bag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from stereo_depth_ros.nodes.live_replay import replay_through_graph

    monkeypatch.setenv("ROS_DOMAIN_ID", domain(2))
    write_odd_bag(tmp_path / "in.mcap", 3, compressed=True, without_right=(1,))
    options = ReplayOptions(bag=str(tmp_path / "in.mcap"), output=str(tmp_path / "live.mcap"))
    result = replay_through_graph(options, "separate", PARAMETERS, CONFIG, lambda sent, total: None)
    process_bag(options.selection, tmp_path / "offline.mcap", CONFIG)
    assert (result.pairs, result.lost, result.unpaired_left, result.unpaired_right) == (2, 0, 1, 0)
    made = sequence(3)
    assert sorted(messages_of(tmp_path / "live.mcap", "/disparity")) == [made.stamp_ns(0), made.stamp_ns(2)]
    assert_equal_messages(tmp_path / "live.mcap", tmp_path / "offline.mcap", SAME_BYTES)


def test_topics_without_subscriber_or_publisher_are_named(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from stereo_depth_ros.nodes.replay import player
    from stereo_depth_ros.nodes.replay_node import replay

    monkeypatch.setenv("ROS_DOMAIN_ID", domain(1))
    monkeypatch.setattr(player, "_GRAPH_TIMEOUT_S", 0.5)
    with pytest.raises(
        GraphError, match=r"/left/image_raw has no subscriber.*/points2 has no publisher.* after 0\.5 s"
    ):
        replay(ReplayOptions(bag=str(bag)), config=CONFIG)


def test_second_publisher_of_an_output_is_refused(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from sensor_msgs.msg import PointCloud2

    from stereo_depth_ros.nodes.replay import player
    from stereo_depth_ros.nodes.replay_node import play

    monkeypatch.setenv("ROS_DOMAIN_ID", domain(1))
    monkeypatch.setattr(player, "_GRAPH_TIMEOUT_S", 0.5)
    context = Context()
    rclpy.init(args=[], context=context)
    try:
        node = Node("two_clouds", context=context)
        publishers = [node.create_publisher(PointCloud2, "points2", 5) for _ in range(2)]
        with pytest.raises(GraphError, match=r"/points2 has 2 publishers, not one after 0\.5 s: run one graph"):
            play(node, ReplayOptions(bag=str(bag)), CONFIG)
        assert len(publishers) == 2
    finally:
        rclpy.shutdown(context=context)


def test_node_that_exits_is_named_with_the_end_of_its_log(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from stereo_depth_ros.nodes.live_replay import replay_through_graph

    monkeypatch.setenv("ROS_DOMAIN_ID", domain(1))
    with pytest.raises(GraphError, match=r"(?s)stereo_depth_node: exited with code 1.*disparity_rang"):
        replay_through_graph(ReplayOptions(bag=str(bag)), "fused", {"disparity_rang": 32}, CONFIG, lambda *_: None)


def test_pairs_without_outputs_are_lost_with_the_error_of_the_node(
    graph: GraphProcesses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from stereo_depth_ros.nodes.replay import player
    from stereo_depth_ros.nodes.replay_node import replay

    monkeypatch.setattr(player, "_LOST_AFTER_S", 1.2)  # longer than the second between two diagnostics
    write_with_smaller_images(tmp_path / "in.mcap")
    shrunk = later(tmp_path / "in.mcap", tmp_path / "later.mcap", seconds=50)
    with pytest.raises(GraphError, match=r"no output for 3 pairs in a row.*the image is 200x148"):
        replay(ReplayOptions(bag=str(shrunk)), check=graph.check, config=CONFIG)


def test_bag_without_stereo_is_refused_before_any_node_starts(tmp_path: Path) -> None:
    from stereo_depth_ros.nodes.live_replay import replay_through_graph

    types = RosbagsTypes()
    with BagWriter(tmp_path / "mono.mcap") as writer:
        writer.write("/cam/image", image_message(types, sequence(1)[0].pair.left.pixels, "mono8", 5, "cam"), 5)
    with pytest.raises(TopicError, match="no stereo pair"):
        replay_through_graph(
            ReplayOptions(bag=str(tmp_path / "mono.mcap")), "fused", {}, CONFIG, lambda sent, total: None
        )


def test_all_nodes_end_with_0_when_they_are_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from stereo_depth_ros.nodes.readiness import wait_until_ready

    monkeypatch.setenv("ROS_DOMAIN_ID", domain(3))
    with GraphProcesses("separate", PARAMETERS, tmp_path) as processes:
        wait_until_ready(processes.numbers, processes.log_lengths, processes.check)
        assert processes.stop() == dict.fromkeys(SHAPES["separate"], 0)


def test_nodes_take_their_sections_of_a_file_and_parameters_override_them(tmp_path: Path) -> None:
    import rclpy

    path = tmp_path / "robot.yaml"
    path.write_text(
        "/**: {ros__parameters: {speckle_size: 20, image_transport: raw}}\n"
        "stereo_depth_node: {ros__parameters: {disparity_range: 64, speckle_range: 3}}\n"
        "disparity_node: {ros__parameters: {disparity_range: 96, qos_overrides: {/x: {publisher: {depth: 2}}}}}\n"
        "camera_driver: {ros__parameters: {exposure: 5}}\n"
    )

    def overrides(shape: str, node: str) -> dict[str, Any]:
        arguments = GraphProcesses(shape, {"disparity_range": 48}, tmp_path, path)._command(node)[3:]
        context = rclpy.Context()
        rclpy.init(args=arguments, context=context)
        found = rclpy.create_node(node, context=context, enable_rosout=False)._parameter_overrides
        context.shutdown()
        return {name: parameter.value for name, parameter in found.items()}

    qos = {"qos_overrides./x.publisher.depth": 2}
    fused = {"speckle_size": 20, "image_transport": "raw", "disparity_range": 48, "speckle_range": 3, **qos}
    assert overrides("fused", "stereo_depth_node") == fused
    assert overrides("separate", "disparity_node") == {"speckle_size": 20, "disparity_range": 48, **qos}
    assert overrides("separate", "point_cloud_node") == {"speckle_size": 20, "disparity_range": 48}


def test_unknown_shape_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GraphError, match="shape 'round' is not one of fused, separate"):
        GraphProcesses("round", {}, tmp_path)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The structured light node in a live graph: however it learns of the patterns, it gives what a scan offline gives."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from graph_harness import Graph
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from scanned import SEQUENCE, captures, errors, infos, messages, pictured, projector_rig, scanner, write_manifest
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Int32
from std_srvs.srv import Trigger
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.active.one_shot.stripes import stripe_pattern
from stereo_depth_ros.active.scanner import Scanner
from stereo_depth_ros.active.shown_patterns import ShownSequence
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes.message_types import RclpyTypes
from stereo_depth_ros.nodes.structured_light_node import StructuredLightNode
from stereo_depth_ros.outputs import OUTPUTS, ResultMessages
from stereo_depth_ros.synthetic.projection import SyntheticScanner

pytestmark = pytest.mark.graph

COUNT = len(SEQUENCE)
TYPES = RclpyTypes()
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
KINDS = {"disparity": DisparityImage, "depth/image_rect": Image, "points2": PointCloud2}


@contextmanager
def node(folder: Path, rig: StereoRig | None = None, **parameters: Any) -> Iterator[Graph]:
    """The node with its camera infos, and listeners of the outputs as ``graph.heard``."""
    write_manifest(folder)
    with Graph(StructuredLightNode, parameters={"patterns": folder / "patterns.json", **parameters}) as graph:
        graph.send(infos(TYPES, rig or scanner().rig, 0))
        yield graph


def seen(graph: Graph) -> int:
    """Captures that the node has looked at."""
    return int(graph.nodes[0].diagnostics.counters["captures"])


def send(graph: Graph, images: tuple[U8, ...], number: int) -> None:
    """Sends one capture, and waits until the node has it."""
    before = seen(graph)
    graph.send(messages(TYPES, images, number))
    graph.wait(lambda: seen(graph) == before + 1, f"capture {number} in the node")


def offline() -> dict[str, Any]:
    """What a scan without a graph gives, by topic."""
    result = Scanner(PipelineConfig(), scanner().rig, ShownSequence(SEQUENCE)).scan(captures())
    types = RosbagsTypes()
    built = ResultMessages(types)
    rows = {row.topic: types.serialize(row.build(built, result)) for row in OUTPUTS if row.topic in KINDS}
    return {topic: deserialize_message(bytes(data), KINDS[topic]) for topic, data in rows.items()}


def unstamped(message: Any) -> Any:
    """The message with stamps of 0: the captures of a test are sent at other times."""
    for each in (message, getattr(message, "image", None)):
        if each is not None:
            each.header.stamp.sec = each.header.stamp.nanosec = 0
    return message


def trigger(graph: Graph, name: str) -> tuple[bool, str]:
    answer = graph.call(Trigger, f"/structured_light_node/{name}", Trigger.Request())
    return answer.success, answer.message


def test_a_program_that_calls_next_for_each_pattern(tmp_path: Path) -> None:
    with node(tmp_path, pattern_signal="service", settle_frames=1) as graph:
        heard = {topic: graph.listen(topic, kind) for topic, kind in KINDS.items()}
        wanted = graph.listen("scan/wanted", Int32, depth=100)
        number = 0
        for pattern, images in enumerate(pictured()):
            told, text = trigger(graph, "next")
            assert told and text.startswith(f"pattern {pattern} of 0 to {COUNT - 1}, {SEQUENCE.patterns[pattern]}")
            for image in (pictured()[0], images, pictured()[1]):  # too early, the right one, and one more
                send(graph, image, number)
                number += 1
            if pattern == 3:
                facts = {item.key: item.value for item in graph.status().values}
                assert facts["patterns"] == f"4 of {COUNT} taken"
                assert facts["missing"].startswith(f"4 ({SEQUENCE.patterns[4]}), 5 (")
        graph.wait(lambda: all(heard.values()), "outputs of the scan")
        for topic, expected in offline().items():
            assert unstamped(heard[topic][0]) == unstamped(expected), topic
        assert [message.data for message in wanted if message.data][:2] == [1, 1]
        late = graph.listen("late", Image)
        graph._subscriptions["depth/image_rect late"] = graph._node.create_subscription(
            Image, "depth/image_rect", late.append, LATCHED
        )
        graph.wait(lambda: late, "the latched depth for a late subscriber")
        disparity = matched_disparity(heard["disparity"][0], scanner().rig)
        error = errors(disparity)
        assert np.mean(error < 1) > 0.98 and np.median(error) < 0.1
        assert not graph.errors(".")


def test_announced_patterns_in_any_order(tmp_path: Path) -> None:
    order = [*range(COUNT - 1, 0, -1), 0]
    with node(tmp_path, pattern_signal="topic", settle_frames=0) as graph:
        heard = graph.listen("disparity", DisparityImage)
        for number, pattern in enumerate(order):
            graph.send({"scan/shown": Int32(data=pattern)})
            graph.wait(lambda p=pattern: graph.nodes[0]._announced._shown == p, f"announcement of {pattern}")
            send(graph, pictured()[pattern], number)
        graph.wait(lambda: heard, "disparity of the scan")
        assert unstamped(heard[0]) == unstamped(offline()["disparity"])
        graph.send({"scan/shown": Int32(data=COUNT)})
        error = graph.wait_error("is announced")
        assert f"pattern {COUNT} is announced, the sequence has 0 to {COUNT - 1}" in error


def test_patterns_are_told_by_their_changes(tmp_path: Path) -> None:
    stream = [images for images in (pictured()[1], *pictured(), pictured()[1]) for _ in range(2)]
    with node(tmp_path, settle_frames=1) as graph:
        heard = graph.listen("disparity", DisparityImage)
        for number, images in enumerate(stream):
            send(graph, images, number)
        graph.wait(lambda: heard, "disparity of the scan")
        assert unstamped(heard[0]) == unstamped(offline()["disparity"])
        assert graph.counter("scans") == 1
        told, text = trigger(graph, "next")
        assert not told and "pattern_signal is images" in text and "pattern_signal:=service" in text


def test_images_that_are_no_sequence_are_said(tmp_path: Path) -> None:
    stream = [pictured()[number] for number in (*range(2, COUNT), *range(2, COUNT), *range(2, COUNT))]
    with node(tmp_path, settle_frames=0) as graph:
        for number, images in enumerate(stream):
            send(graph, images, number)
        status = graph.status()
        assert status.message.startswith(f"{len(stream)} different images, and no {COUNT} of them in a row are the")
        assert trigger(graph, "restart") == (True, "begun again: all patterns are missing")
        assert graph.status().message == "ok"


def test_one_camera_and_a_projector(tmp_path: Path) -> None:
    rig = projector_rig()
    with node(tmp_path, rig, projector=True, settle_frames=0) as graph:
        heard = graph.listen("depth/image_rect", Image)
        for number, images in enumerate(pictured()):
            send(graph, images[:1], number)
        graph.wait(lambda: heard, "depth of the scan")
        depth_m = np.frombuffer(heard[0].data, np.float32).reshape(rig.height, rig.width)
        found = np.isfinite(depth_m)
        assert found.mean() > 0.4
        assert 0.7 < np.median(depth_m[found]) < 1.5
        assert heard[0].header.frame_id == rig.left.frame_id


def test_color_stripes_make_every_pair_a_scan(tmp_path: Path) -> None:
    own, pattern = SyntheticScanner(240, 180, (256, 192)), stripe_pattern((256, 192), stripe_px=4)
    cv2.imwrite(str(tmp_path / "stripes.png"), cv2.cvtColor(pattern, cv2.COLOR_RGB2BGR))
    pairs = [own.capture(pattern) for _ in range(2)]
    cameras, sides = (own.rig.left, own.rig.right), ("left", "right")
    with Graph(StructuredLightNode, parameters={"patterns": tmp_path / "stripes.png"}) as graph:
        heard = graph.listen("disparity", DisparityImage)
        for number, images in enumerate(pairs, start=1):
            stamp_ns = number * 10**9
            sent = {
                f"{side}/camera_info": camera_info_message(TYPES, camera, stamp_ns)
                for side, camera in zip(sides, cameras, strict=True)
            }
            for side, camera, image in zip(sides, cameras, images, strict=True):
                sent[f"{side}/image_raw"] = image_message(TYPES, image, "rgb8", stamp_ns, camera.frame_id)
            graph.send(sent)
            graph.wait(lambda n=number: len(heard) == n, f"scan {number}")
        for message, number in zip(heard, (1, 2), strict=True):
            assert message.header.stamp.sec == number
            found = matched_disparity(message, own.rig)
            error = np.abs(found - own.truth().disparity_px)[np.isfinite(found)]
            assert np.isfinite(found).mean() > 0.25 and np.mean(error < 1) > 0.95
        graph.send({"left/image_raw": image_message(TYPES, pairs[0][0][..., 0].copy(), "mono8", 5 * 10**9, "")})
        graph.send({"right/image_raw": image_message(TYPES, pairs[0][1][..., 0].copy(), "mono8", 5 * 10**9, "")})
        assert "the image is gray, color stripes need colors" in graph.wait_error("color stripes")


def test_without_patterns_the_node_does_not_start() -> None:
    with pytest.raises(ConfigError, match="no patterns are named"):
        Graph(StructuredLightNode)

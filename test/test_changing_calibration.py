# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes while the calibration changes: every pair gets the camera infos of its own stamp, live and offline."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from graph_harness import NS_PER_S, Graph, StereoCamera
from sensor_msgs.msg import Image
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode

pytestmark = pytest.mark.graph

SMALL = {"disparity_range": 32, "correlation_window_size": 9}
FIRST_NS, STEP_NS = 10 * NS_PER_S, NS_PER_S // 10
LEFT, RIGHT = "left/image_raw", "right/image_raw"
LEFT_INFO, RIGHT_INFO = "left/camera_info", "right/camera_info"
A, B = 1.0, 1.5  # scales of the baseline

# Arrivals as (topic, frame, scale of the baseline in a camera info); B applies from frame 2 on.
RIGHT_LATE = [
    *[(LEFT_INFO, 0, A), (RIGHT_INFO, 0, A), (LEFT, 0, A)],
    *[(LEFT_INFO, 1, A), (RIGHT_INFO, 1, A), (LEFT, 1, A), (RIGHT, 0, A)],
    *[(LEFT_INFO, 2, B), (RIGHT_INFO, 2, B), (LEFT, 2, B), (RIGHT, 1, A)],
    *[(LEFT_INFO, 3, B), (RIGHT_INFO, 3, B), (LEFT, 3, B), (RIGHT, 2, B), (RIGHT, 3, B)],
]
IMAGES_FIRST = [
    arrival
    for frame, scale in enumerate((A, A, B, B))
    for arrival in ((LEFT, frame, scale), (LEFT_INFO, frame, scale), (RIGHT, frame, scale), (RIGHT_INFO, frame, scale))
]
UNSTAMPED = [
    *[(LEFT_INFO, None, A), (RIGHT_INFO, None, A)],
    *[(topic, frame, A) for frame in (0, 1) for topic in (LEFT, RIGHT)],
    *[(LEFT_INFO, None, B), (RIGHT_INFO, None, B)],
    *[(topic, frame, B) for frame in (2, 3) for topic in (LEFT, RIGHT)],
]
CASES = {"right image late": RIGHT_LATE, "images before infos": IMAGES_FIRST, "infos without stamps": UNSTAMPED}


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera()


def message_of(camera: StereoCamera, topic: str, frame: int | None, scale: float) -> Any:
    stamp_ns = 0 if frame is None else FIRST_NS + frame * STEP_NS
    message = camera.pair(stamp_ns)[topic]
    if topic.endswith("camera_info"):
        scaled = message.p.copy()
        scaled[3] *= scale
        message.p = scaled
        message.d = np.multiply(message.d, scale)  # so that the left camera info changes too
    return message


def play(graph: Graph, camera: StereoCamera, arrivals: Iterable[tuple[str, int | None, float]]) -> None:
    """One message after the other: the node has taken each before the next one is sent."""
    node = graph.nodes[0]
    for topic, frame, scale in arrivals:
        taken = sum(item._received for item in node._inputs)
        graph.send({topic: message_of(camera, topic, frame, scale)})
        graph.wait(lambda count=taken: sum(item._received for item in node._inputs) > count, f"{topic} taken")


def baselines_m(messages: Iterable[Any]) -> list[float]:
    return [round(message.t, 4) for message in messages]


@pytest.mark.parametrize("arrivals", CASES.values(), ids=CASES.keys())
def test_pairs_have_the_calibration_of_their_stamp_live(arrivals: list[Any], camera: StereoCamera) -> None:
    base_m = camera.rig.baseline_m
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        play(graph, camera, arrivals)
        graph.wait(lambda: len(received) == 4, "4 disparities")
        assert baselines_m(received) == [round(scale * base_m, 4) for scale in (A, A, B, B)]
        assert graph.status().level == DiagnosticStatus.OK


@pytest.mark.parametrize("arrivals", CASES.values(), ids=CASES.keys())
def test_pairs_have_the_calibration_of_their_stamp_offline(
    arrivals: list[Any], camera: StereoCamera, tmp_path: Path
) -> None:
    path, types = tmp_path / "changing.mcap", RosbagsTypes()
    offline = StereoCamera.__new__(StereoCamera)
    offline.types, offline.rig, offline.frames = types, camera.rig, camera.frames  # type: ignore[assignment]
    with BagWriter(path) as bag:
        for number, (topic, frame, scale) in enumerate(arrivals):
            bag.write(f"/{topic}", message_of(offline, topic, frame, scale), FIRST_NS + number * STEP_NS // 4)
    with BagPairs(BagSelection(path), PairingConfig()) as pairs:
        found = [round(pair.rig(types).baseline_m, 4) for pair in pairs.pairs()]
    assert found == [round(scale * camera.rig.baseline_m, 4) for scale in (A, A, B, B)]


def test_a_pair_waits_for_changed_infos_no_longer_than_a_moment(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        play(graph, camera, [(LEFT_INFO, 0, A), (RIGHT_INFO, 0, A), (LEFT_INFO, 1, B), (LEFT, 1, B), (RIGHT, 1, B)])
        graph.wait(lambda: received, "disparity though the right camera info of its stamp never comes")
        assert baselines_m(received) == [round(camera.rig.baseline_m, 4)]


def test_a_pair_of_two_cameras_is_published_with_infos_of_its_own_stamp_or_not_at_all(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        of_a = [(topic, frame, A) for frame in (0, 1) for topic in (LEFT_INFO, RIGHT_INFO, LEFT, RIGHT)]
        play(graph, camera, of_a)
        graph.wait(lambda: len(received) == 2, "disparities of one camera")
        other = graph._node.create_publisher(Image, LEFT, 10)
        graph.wait(lambda: other.get_subscription_count() == 1, "connection of a second camera")
        play(graph, camera, [(LEFT, 2, B), (RIGHT, 2, B)])  # its camera infos are not received yet
        graph.wait(lambda: graph.counter("dropped without calibration") == 1, "the pair to be dropped")
        play(graph, camera, [(topic, 3, B) for topic in (LEFT, RIGHT, LEFT_INFO, RIGHT_INFO)])
        graph.wait(lambda: len(received) == 3, "disparity of the second camera")
        assert baselines_m(received) == [round(scale * camera.rig.baseline_m, 4) for scale in (A, A, B)]
        assert graph.errors("several cameras publish the same topics, and a pair without camera infos")


def test_changed_infos_that_come_after_their_pair_are_said(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        received = graph.listen("disparity", DisparityImage)
        play(graph, camera, [(LEFT_INFO, 0, A), (RIGHT_INFO, 0, A), (LEFT, 0, A), (RIGHT, 0, A)])
        play(graph, camera, [(LEFT, 1, B), (RIGHT, 1, B)])
        graph.wait(lambda: len(received) == 2, "2 disparities, the second without waiting")
        play(graph, camera, [(LEFT_INFO, 1, B), (RIGHT_INFO, 1, B)])
        graph.wait(lambda: graph.counter("late camera infos") == 2, "late camera infos counted")
        status = graph.status()
        assert status.level == DiagnosticStatus.WARN
        assert (
            "/left/camera_info or /right/camera_info changed after pairs of its stamp were computed" in status.message
        )
        play(graph, camera, [(LEFT, 2, B), (RIGHT, 2, B), (LEFT_INFO, 2, B), (RIGHT_INFO, 2, B)])
        graph.wait(lambda: len(received) == 3, "third disparity")
        assert baselines_m(received)[2] == round(B * camera.rig.baseline_m, 4)

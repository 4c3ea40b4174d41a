# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every disparity gets its cloud, however long the matcher takes: color images wait for it, within their memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from graph_harness import NS_PER_S, Graph, StereoCamera
from sensor_msgs.msg import PointCloud2

from stereo_depth_ros.messages.disparity import disparity_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.nodes import point_cloud_node
from stereo_depth_ros.nodes.point_cloud_node import PointCloudNode

pytestmark = pytest.mark.graph

DISPARITY, COLOR = "disparity", "left/image_rect_color"


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera(frames=1, width=64, height=48)


def disparity_of(camera: StereoCamera, stamp_ns: int) -> Any:
    pixels = np.full((48, 64), 8, np.float32)
    return disparity_message(
        camera.types, pixels, camera.rig, min_disparity=0, max_disparity=31, step_px=1, stamp_ns=stamp_ns, frame_id="a"
    )


def color_of(camera: StereoCamera, stamp_ns: int) -> Any:
    return image_message(camera.types, np.full((48, 64), 100, np.uint8), "mono8", stamp_ns, "a")


def stamps_ns(count: int) -> list[int]:
    return [NS_PER_S + number * NS_PER_S // 20 for number in range(count)]


def started(graph: Graph, camera: StereoCamera) -> tuple[list[Any], dict[str, Any]]:
    """The clouds received, and the callback of each input."""
    received = graph.listen("points2", PointCloud2, depth=100)
    graph.send(camera.infos(NS_PER_S))
    graph.wait(lambda: graph.nodes[0]._calibration._infos.is_known, "camera infos")
    return received, {item.topic: item._callback for item in graph.nodes[0]._inputs}


def test_disparities_of_a_slow_matcher_get_their_clouds(camera: StereoCamera) -> None:
    stamps = stamps_ns(40)
    with Graph(PointCloudNode) as graph:
        received, receive = started(graph, camera)
        for stamp in stamps:
            receive[COLOR](color_of(camera, stamp))
        values = {item.key: item.value for item in graph.status().values}
        assert values["color images kept"] == f"40, limit {(256 << 20) // (48 * 64)} (256 MiB)"
        for count, stamp in enumerate(stamps[::2], start=1):
            receive[DISPARITY](disparity_of(camera, stamp))
            graph.wait(lambda count=count: len(received) == count, f"cloud {count}")
        assert graph.counter("unpaired disparity") == 0
        assert graph.counter("unpaired left/image_rect_color") == 19, "those that the matcher skipped"


def test_color_images_that_wait_are_bounded_in_memory(camera: StereoCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(point_cloud_node, "_COLOR_BYTES", 10 * 48 * 64)
    stamps = stamps_ns(40)
    with Graph(PointCloudNode) as graph:
        _, receive = started(graph, camera)
        for stamp in stamps:
            receive[COLOR](color_of(camera, stamp))
        assert graph.counter("unpaired left/image_rect_color") == 30
        assert graph.nodes[0]._pairs.waiting_right == 10


def test_images_that_arrived_before_a_disparity_are_taken_before_it(camera: StereoCamera) -> None:
    """More of them than the executor takes between two disparities, and than queue_size."""
    stamps = stamps_ns(12)
    with Graph(PointCloudNode) as graph:
        received, _ = started(graph, camera)
        publishers = {topic: graph.advertise(topic, kind) for topic, kind in _kinds(camera).items()}
        graph.wait(lambda: all(p.get_subscription_count() for p in publishers.values()), "subscriptions")
        for stamp in stamps:
            publishers[COLOR].publish(color_of(camera, stamp))
        for stamp in stamps[-4:]:
            publishers[DISPARITY].publish(disparity_of(camera, stamp))
        graph.wait(lambda: received, "first cloud")
        taken = graph.nodes[0].diagnostics.counters["unpaired left/image_rect_color"]
        assert taken == 8, "all images older than the disparity were there"
        graph.wait(lambda: len(received) == 4, "4 clouds")


def _kinds(camera: StereoCamera) -> dict[str, Any]:
    return {COLOR: type(color_of(camera, 1)), DISPARITY: type(disparity_of(camera, 1))}

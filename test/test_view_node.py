# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The view node in a live graph, behind the fused and the separate nodes: the views of the library, byte for byte."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from graph_harness import NS_PER_S, Graph, StereoCamera, colored, image_pixels
from sensor_msgs.msg import Image
from std_msgs.msg import Float64

from stereo_depth_ros.config import MatchingConfig, PipelineConfig, ViewConfig
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.types import Frame, StereoPair
from stereo_depth_ros.messages.disparity import match_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.disparity_node import DisparityNode
from stereo_depth_ros.nodes.rectify_node import RectifyNode
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode
from stereo_depth_ros.nodes.view_node import ViewNode
from stereo_depth_ros.pipeline import StereoPipeline, StereoResult
from stereo_depth_ros.views.anaglyph import anaglyph
from stereo_depth_ros.views.color_maps import depth_color, disparity_color
from stereo_depth_ros.views.convergence import converged, subject_disparity
from stereo_depth_ros.views.frame import RECTIFIED
from stereo_depth_ros.views.interpolation import interpolate_view
from stereo_depth_ros.views.result_frames import ResultFrames
from stereo_depth_ros.views.topics import VIEWS, ViewMessages

pytestmark = pytest.mark.graph

STAMP_NS = 5 * NS_PER_S + 77
CONFIG = PipelineConfig(matching=MatchingConfig(num_disparities=32))
PARAMETERS = {"disparity_range": 32}
INPUTS = ("left/camera_info", "right/camera_info", "disparity", *RECTIFIED, "view/position")
COLOR_MAPS = ("disparity_color", "depth_color")


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera()


@pytest.fixture(scope="module")
def results(camera: StereoCamera) -> list[StereoResult]:
    """Both frames of the camera in color, from the pipeline."""
    pipeline = StereoPipeline(CONFIG, camera.rig)
    found = []
    for index in range(2):
        pair = camera.frames[index].pair
        sides = (
            Frame(colored(side.pixels), STAMP_NS + index * NS_PER_S, side.frame_id, "rgb8")
            for side in (pair.left, pair.right)
        )
        found.append(pipeline.process(StereoPair(*sides)))
    return found


def sent(camera: StereoCamera, result: StereoResult) -> dict[str, Any]:
    """What the other nodes publish for a result."""
    stamp, pair = result.stamp_ns, result.pair
    images = zip(RECTIFIED, (result.left_image, result.right_image), (pair.left, pair.right), strict=True)
    return {
        **camera.infos(stamp),
        **{topic: image_message(camera.types, *image, stamp, side.frame_id) for topic, image, side in images},
        "disparity": match_message(
            camera.types, PayloadPool(camera.types), result.disparity, CONFIG.matching, camera.rig, result.pair.left
        ),
    }


def drawn(camera: StereoCamera, results: list[StereoResult], config: ViewConfig | None = None) -> dict[str, list[Any]]:
    """The messages of all views of a stream, without a graph."""
    frames, messages = ResultFrames(), ViewMessages(camera.types)
    found: dict[str, list[Any]] = {topic: [] for topic in VIEWS}
    for result in results:
        frame = frames.of(result)
        for topic in VIEWS:
            message = messages.build(topic, frame, config or ViewConfig())
            found[topic].append((image_pixels(message).copy(), message.encoding, stamp_ns(message.header)))
    return found


@pytest.mark.parametrize("shape", [(StereoDepthNode,), (RectifyNode, DisparityNode)], ids=["fused", "separate"])
def test_views_of_both_shapes_are_those_of_the_library(
    camera: StereoCamera, results: list[StereoResult], shape: tuple[Any, ...]
) -> None:
    expected = drawn(camera, results)
    with Graph(*shape, ViewNode, parameters=PARAMETERS) as graph:
        received = {topic: graph.listen(topic, Image) for topic in VIEWS}
        for index, result in enumerate(results):
            stamp = result.stamp_ns
            infos, images = camera.infos(stamp), camera.images(stamp, index, "rgb8")
            graph.send(infos, subscribers=len(graph.nodes))
            graph.send(images)
            graph.wait(lambda count=index + 1: all(len(m) == count for m in received.values()), "every view")
        counters = {name: graph.counter(name, graph.nodes[-1]) for name in ("paired", "disparities without images")}
    assert counters == {"paired": 2, "disparities without images": 0}
    for topic in VIEWS:
        for message, (pixels, encoding, stamp) in zip(received[topic], expected[topic], strict=True):
            assert (message.encoding, stamp_ns(message.header)) == (encoding, stamp) == ("bgr8", stamp)
            assert message.header.frame_id == results[0].frame_id
            np.testing.assert_array_equal(image_pixels(message), pixels)


def test_content_of_the_views(camera: StereoCamera, results: list[StereoResult]) -> None:
    """By the functions, from the arrays of the pipeline."""
    result = results[0]
    left, right = (np.ascontiguousarray(image[..., ::-1]) for image, _ in (result.left_image, result.right_image))
    disparity_px, rig = result.disparity.disparity_px, camera.rig
    config = ViewConfig(view_position=0.25, anaglyph_method="half-color", color_legend=True, depth_near=1.0)
    found = {topic: messages[0][0] for topic, messages in drawn(camera, [result], config).items()}
    shift_px = subject_disparity(disparity_px)
    doffs = np.float32(rig.doffs_px)
    expected = {
        "view/image": interpolate_view(left, right, disparity_px, 0.25),
        "anaglyph": anaglyph(*converged(left, right, shift_px), "half-color"),
        "disparity_color": disparity_color(disparity_px - doffs, 0 - doffs, 31 - doffs, legend=True),
        "depth_color": depth_color(result.depth_m, 1.0, legend=True),
    }
    for topic, image in expected.items():
        assert found[topic].shape == image.shape
        # the published disparities are rounded to float32 once more
        assert np.mean(np.abs(found[topic].astype(int) - image)) < 0.1, topic


def test_inputs_follow_the_demand() -> None:
    with Graph(ViewNode) as graph:
        graph.spin(0.2)
        assert graph.subscriptions(*INPUTS) == [0] * 6
        graph.listen("depth_color", Image)
        graph.wait(lambda: graph.subscriptions(*INPUTS) == [1, 1, 1, 0, 0, 1], "inputs without images")
        graph.listen("anaglyph", Image)
        graph.wait(lambda: graph.subscriptions(*INPUTS) == [1] * 6, "all inputs")
        graph.stop_listening("anaglyph")
        graph.stop_listening("depth_color")
        graph.wait(lambda: graph.subscriptions(*INPUTS) == [0] * 6, "end of the subscriptions")


def test_color_maps_do_not_wait_for_images(camera: StereoCamera, results: list[StereoResult]) -> None:
    with Graph(ViewNode) as graph:
        received = {topic: graph.listen(topic, Image) for topic in COLOR_MAPS}
        views = graph.listen("view/image", Image)
        messages = sent(camera, results[0])
        images = {topic: messages.pop(topic) for topic in RECTIFIED}
        graph.send(messages)
        graph.wait(lambda: all(received.values()), "color maps")
        assert not views
        graph.send(images)
        graph.wait(lambda: views, "view once the images are there")


def test_position_moves_the_view(camera: StereoCamera, results: list[StereoResult]) -> None:
    with Graph(ViewNode) as graph:
        received = graph.listen("view/image", Image)

        def next_view(number: int) -> Any:
            later = dataclasses.replace(results[0].pair.left, stamp_ns=STAMP_NS + number * NS_PER_S)
            pair = StereoPair(later, dataclasses.replace(results[0].pair.right, stamp_ns=later.stamp_ns))
            graph.send(sent(camera, dataclasses.replace(results[0], pair=pair)))
            graph.wait(lambda: len(received) == number, f"view {number}")
            return image_pixels(received[-1]).copy()

        def at(position: float) -> Any:
            return drawn(camera, results[:1], ViewConfig(view_position=position))["view/image"][0][0]

        np.testing.assert_array_equal(next_view(1), at(0.5))
        graph.send({"view/position": Float64(data=0.0)})
        node = graph.nodes[0]
        graph.wait(lambda: node.get_parameter("view_position").value == 0.0, "position by message")
        np.testing.assert_array_equal(next_view(2), at(0.0))
        assert graph.set_parameter("view_position", 1.25, "view_node").successful
        np.testing.assert_array_equal(next_view(3), at(1.25))
        graph.send({"view/position": Float64(data=float("nan"))})
        graph.send({"view/position": Float64(data=2.0)})
        graph.wait_error(r"/view/position: parameter view_position = 2\.0 is outside -0\.5\.\.1\.5")
        np.testing.assert_array_equal(next_view(4), at(1.25))
        for _ in range(2):  # the first one begins the interval
            node._report_silence()
        assert "/view/position" not in graph.wait_error("nothing received")


def test_disparities_without_images_are_counted(camera: StereoCamera, results: list[StereoResult]) -> None:
    with Graph(ViewNode, parameters={"queue_size": 1}) as graph:
        received, colors = graph.listen("anaglyph", Image), graph.listen("disparity_color", Image)
        for number in range(4):
            messages = sent(camera, results[0])
            messages["disparity"].header.stamp.sec += number
            graph.send({topic: messages[topic] for topic in ("left/camera_info", "right/camera_info", "disparity")})
            graph.wait(lambda count=number + 1: len(colors) == count, "color map of every disparity")
        assert graph.counter("disparities without images") == 3
        graph.wait(lambda: any("no images with the stamps" in log.msg for log in graph.logs), "cause in the log")
        last = messages["disparity"].header.stamp.sec
        images = {topic: messages[topic] for topic in RECTIFIED}
        for image in images.values():
            image.header.stamp.sec = last
        graph.send(images)
        graph.wait(lambda: received, "anaglyph of the last disparity")


def test_wrong_images_are_reported_and_survived(camera: StereoCamera, results: list[StereoResult]) -> None:
    with Graph(ViewNode) as graph:
        received = graph.listen("anaglyph", Image)
        messages = sent(camera, results[0])
        small = np.zeros((60, 100), np.uint8)
        for topic, side in zip(RECTIFIED, (results[0].pair.left, results[0].pair.right), strict=True):
            messages[topic] = image_message(camera.types, small, "mono8", STAMP_NS, side.frame_id)
        graph.send(messages)
        graph.wait_error("/left/image_rect_color: the image is 100x60, its camera info is for 200x120")
        graph.send(sent(camera, results[1]))
        graph.wait(lambda: received, "anaglyph after wrong images")


def test_equal_topics_are_refused() -> None:
    with pytest.raises(TopicError, match="left/image_rect_color and right/image_rect_color are both /same"):
        Graph(ViewNode, remaps=dict.fromkeys(RECTIFIED, "/same"))

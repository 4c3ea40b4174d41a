# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The nodes in a live graph: what they publish, in which shape they run, and how they end."""

from __future__ import annotations

import dataclasses
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graph_harness import NS_PER_S, Graph, NodeProcess, StereoCamera, colored, image_pixels, ros_arguments
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.messages.image import compressed_message
from stereo_depth_ros.nodes.depth_node import DepthNode
from stereo_depth_ros.nodes.disparity_node import DisparityNode
from stereo_depth_ros.nodes.point_cloud_node import PointCloudNode
from stereo_depth_ros.nodes.rectify_node import RectifyNode
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode
from stereo_depth_ros.outputs import MATCH_OUTPUTS, ResultMessages
from stereo_depth_ros.outputs import OUTPUTS as ALL_OUTPUTS
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.stages.rectification import Rectifier

pytestmark = pytest.mark.graph

STAMP_NS = 5 * NS_PER_S + 123_456_789
FRAME_ID = "left_camera_optical_frame"
WIDTH, HEIGHT, RANGE, WINDOW = 200, 120, 32, 9
SUPPORT = (7, 5)  # of the matcher sgm: its census window
PARAMETERS = {"disparity_range": RANGE, "correlation_window_size": WINDOW}
SEPARATE = (RectifyNode, DisparityNode, PointCloudNode, DepthNode)
RAW_TOPICS = ("left/image_raw", "right/image_raw", "left/camera_info", "right/camera_info")
OUTPUTS = {
    "left/image_rect": Image,
    "left/image_rect_color": Image,
    "right/image_rect": Image,
    "right/image_rect_color": Image,
    "disparity": DisparityImage,
    "depth/image_rect": Image,
    "depth/camera_info": CameraInfo,
    "points2": PointCloud2,
    "confidence": Image,
    "confidence_mono8": Image,
    "reasons_color": Image,
    "error_disparity": Image,
    "error_depth": Image,
}
COMPARED = ("points2", "disparity", "depth/image_rect")


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera()


def one_pair(graph: Graph, messages: dict[str, Any], outputs: dict[str, Any]) -> dict[str, Any]:
    """Messages of the outputs after one pair; none arrives twice."""
    received = {topic: graph.listen(topic, kind) for topic, kind in outputs.items()}
    infos = {topic: message for topic, message in messages.items() if topic.endswith("camera_info")}
    graph.send(infos, subscribers=len(graph.nodes))
    graph.send({topic: message for topic, message in messages.items() if topic not in infos})
    graph.wait(lambda: all(received.values()), f"message on each of {', '.join(received)}")
    assert {topic: len(found) for topic, found in received.items()} == dict.fromkeys(outputs, 1)
    return {topic: found[0] for topic, found in received.items()}


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * NS_PER_S + int(message.header.stamp.nanosec)


def cloud_values(message: PointCloud2, name: str, dtype: str = "<f4") -> Any:
    """One field of an organized cloud, (H, W)."""
    offset = next(field.offset for field in message.fields if field.name == name)
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, message.point_step)
    return np.ascontiguousarray(rows[:, :, offset : offset + 4]).view(dtype)[:, :, 0]


@pytest.fixture(scope="module")
def fused(camera: StereoCamera) -> dict[str, Any]:
    """Every output of the fused node for one gray pair."""
    with Graph(StereoDepthNode, parameters=PARAMETERS) as graph:
        return one_pair(graph, camera.pair(STAMP_NS), OUTPUTS)


@pytest.mark.parametrize("topic", OUTPUTS)
def test_every_output_has_the_header_of_the_left_image_and_its_size(fused: dict[str, Any], topic: str) -> None:
    message = fused[topic]
    assert stamp_ns(message) == STAMP_NS
    expected = "right_camera_optical_frame" if topic.startswith("right") else FRAME_ID
    assert message.header.frame_id == expected
    sized = message.image if topic == "disparity" else message
    assert (sized.width, sized.height) == (WIDTH, HEIGHT)


def test_rectified_images_are_those_of_the_rectifier(fused: dict[str, Any], camera: StereoCamera) -> None:
    rectified = Rectifier(camera.rig).rectify(camera.frames[0].pair)
    for topic, expected in (
        ("left/image_rect", rectified.left),
        ("left/image_rect_color", rectified.left),
        ("right/image_rect", rectified.right),
    ):
        assert fused[topic].encoding == "mono8"
        np.testing.assert_array_equal(image_pixels(fused[topic]), expected)


def test_disparity_message_describes_the_rig_and_the_search(fused: dict[str, Any], camera: StereoCamera) -> None:
    message, doffs = fused["disparity"], camera.rig.doffs_px
    assert message.image.header == message.header
    assert message.image.encoding == "32FC1"
    right = camera.rig.right.P
    assert message.f == pytest.approx(right[0, 0], rel=1e-7)  # float32 fields
    assert message.t == pytest.approx(-right[0, 3] / right[0, 0], rel=1e-7)
    assert doffs > 1  # published disparities are shifted by it, so the test needs one
    assert (message.min_disparity, message.max_disparity) == pytest.approx((-doffs, RANGE - 1 - doffs), rel=1e-6)
    assert message.delta_d == pytest.approx(1 / 64)
    window, (beside, above) = message.valid_window, (SUPPORT[0] // 2, SUPPORT[1] // 2)
    assert (window.x_offset, window.y_offset) == (RANGE - 1 + beside, above)
    assert (window.width, window.height) == (WIDTH - RANGE + 1 - 2 * beside, HEIGHT - 2 * above)


def test_disparity_depth_and_truth_agree(fused: dict[str, Any], camera: StereoCamera) -> None:
    message, frame = fused["disparity"], camera.frames[0]
    disparity_px, depth_m = image_pixels(message.image), image_pixels(fused["depth/image_rect"])
    valid = disparity_px >= message.min_disparity
    assert 0.5 < valid.mean() < 1
    np.testing.assert_array_equal(np.isfinite(depth_m), valid)
    np.testing.assert_allclose(depth_m[valid], message.f * message.t / disparity_px[valid], rtol=1e-5)
    seen = valid & ~frame.occluded
    truth_px = message.f * message.t / frame.truth_depth_m[seen]
    # The matcher's own error: a fraction of a pixel; a wrong offset of the principal points would be 3 px.
    assert np.median(np.abs(disparity_px[seen] - truth_px)) < 0.25
    assert np.median(depth_m[seen]) == pytest.approx(np.median(frame.truth_depth_m[seen]), rel=0.03)


def test_camera_info_of_the_depth_is_rectified(fused: dict[str, Any], camera: StereoCamera) -> None:
    info, P = fused["depth/camera_info"], camera.rig.left.P
    np.testing.assert_allclose(info.p, P.ravel())
    np.testing.assert_allclose(info.k, P[:, :3].ravel())
    np.testing.assert_allclose(info.r, np.identity(3).ravel())
    assert list(info.d) == [0.0] * 5


def test_points_are_the_depth_along_the_rays(fused: dict[str, Any], camera: StereoCamera) -> None:
    cloud, depth_m = fused["points2"], image_pixels(fused["depth/image_rect"])
    assert (cloud.point_step, cloud.row_step, cloud.is_dense, cloud.is_bigendian) == (32, 32 * WIDTH, False, False)
    K = camera.rig.left.P[:, :3]
    v, u = np.indices(depth_m.shape)
    np.testing.assert_array_equal(cloud_values(cloud, "z"), depth_m)
    # float32 against float64: a few parts in 10^7 of the largest coordinate.
    np.testing.assert_allclose(cloud_values(cloud, "x"), (u - K[0, 2]) / K[0, 0] * depth_m, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(cloud_values(cloud, "y"), (v - K[1, 2]) / K[1, 1] * depth_m, rtol=1e-5, atol=1e-6)
    gray = image_pixels(fused["left/image_rect"]).astype(np.uint32)
    np.testing.assert_array_equal(cloud_values(cloud, "rgb", "<u4"), gray * 0x010101)


def test_color_image_colors_the_cloud(camera: StereoCamera) -> None:
    outputs = {topic: OUTPUTS[topic] for topic in ("left/image_rect_color", "left/image_rect", "points2")}
    with Graph(StereoDepthNode, parameters={**PARAMETERS, "avoid_point_cloud_padding": True}) as graph:
        received = one_pair(graph, camera.pair(STAMP_NS, encoding="rgb8"), outputs)
    color, cloud = received["left/image_rect_color"], received["points2"]
    assert (color.encoding, received["left/image_rect"].encoding, cloud.point_step) == ("rgb8", "mono8", 16)
    expected = Rectifier(camera.rig).rectify_left(colored(camera.frames[0].pair.left.pixels))
    np.testing.assert_array_equal(image_pixels(color), expected)
    red, green, blue = np.moveaxis(expected.astype(np.uint32), 2, 0)
    np.testing.assert_array_equal(cloud_values(cloud, "rgb", "<u4"), red << 16 | green << 8 | blue)


def test_depth_in_millimeters(fused: dict[str, Any], camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters={**PARAMETERS, "depth_encoding": "16UC1"}) as graph:
        message = one_pair(graph, camera.pair(STAMP_NS), {"depth/image_rect": Image})["depth/image_rect"]
    assert message.encoding == "16UC1"
    depth_m, depth_mm = image_pixels(fused["depth/image_rect"]), image_pixels(message)
    expected = np.nan_to_num(np.where(depth_m < 65.5355, depth_m, 0) * 1000.0)
    assert depth_mm.max() > 1000
    np.testing.assert_allclose(depth_mm, expected, atol=0.501)  # half a millimeter of rounding


def test_separate_nodes_give_the_bytes_of_the_fused_node(fused: dict[str, Any], camera: StereoCamera) -> None:
    outputs = {topic: OUTPUTS[topic] for topic in ("points2", "disparity", "depth/image_rect", "depth/camera_info")}
    with Graph(*SEPARATE, parameters=PARAMETERS) as graph:
        received = one_pair(graph, camera.pair(STAMP_NS), outputs)
    assert received["disparity"] == fused["disparity"]
    assert received["depth/camera_info"] == fused["depth/camera_info"]
    assert received["depth/image_rect"].data == fused["depth/image_rect"].data
    assert received["points2"].data == fused["points2"].data


@pytest.mark.parametrize("node_types", [(StereoDepthNode,), SEPARATE[:3]])
def test_confidence_and_errors_have_the_bytes_of_the_offline_engine(
    node_types: tuple[Any, ...], camera: StereoCamera
) -> None:
    parameters = PARAMETERS | {"point_quality": True, "use_color": False, "min_confidence": 0.1, "max_depth_error": 0.5}
    outputs = {"points2": PointCloud2, **{row.topic: Image for row in MATCH_OUTPUTS}}
    with Graph(*node_types, parameters=parameters) as graph:
        received = one_pair(graph, camera.pair(STAMP_NS), outputs)
        reported = graph.nodes[min(1, len(node_types) - 1)].diagnostics  # of the node that matches
        values = {value.key: value.value for value in reported._message().status[0].values}
    config = pipeline_config(parameters)
    raw = camera.frames[0].pair
    left, right = (dataclasses.replace(frame, stamp_ns=STAMP_NS) for frame in (raw.left, raw.right))
    result = StereoPipeline(config, camera.rig).process(StereoPair(left, right))
    messages = ResultMessages(camera.types)
    for row in (*MATCH_OUTPUTS, *(row for row in ALL_OUTPUTS if row.topic == "points2")):
        expected = row.build(messages, result)
        assert bytes(received[row.topic].data) == bytes(expected.data), row.topic
        assert received[row.topic].header == expected.header
    assert [field.name for field in received["points2"].fields] == ["x", "y", "z", "confidence", "sigma"]
    np.testing.assert_array_equal(cloud_values(received["points2"], "sigma"), result.sigma_m)
    by_confidence, by_error = result.disparity.beyond_limits
    assert min(by_confidence, by_error) > 100
    assert values["with a disparity"] == f"{100 * result.disparity.valid_fraction:.2f} %"
    assert values["no disparity, below min_confidence"] == f"{100 * by_confidence / (WIDTH * HEIGHT):.2f} %"
    assert values["no disparity, depth error"] == f"{100 * by_error / (WIDTH * HEIGHT):.2f} %"
    left_right = result.disparity.reason_counts()["LEFT_RIGHT"]
    assert values["no disparity, LEFT_RIGHT"] == f"{100 * left_right / (WIDTH * HEIGHT):.2f} %"


@pytest.mark.parametrize("node_types", [(StereoDepthNode,), (DisparityNode, DepthNode, PointCloudNode)])
def test_camera_infos_with_only_p_are_of_rectified_images(
    node_types: tuple[Any, ...], fused: dict[str, Any], camera: StereoCamera
) -> None:
    messages = camera.infos(STAMP_NS)
    for info in messages.values():
        info.distortion_model, info.d = "", []
        info.k, info.r = np.zeros(9), np.zeros(9)
    image = "image_raw" if len(node_types) == 1 else "image_rect"
    messages |= {f"{side}/{image}": fused[f"{side}/image_rect"] for side in ("left", "right")}
    outputs = {topic: OUTPUTS[topic] for topic in ("points2", "disparity", "depth/image_rect", "depth/camera_info")}
    with Graph(*node_types, parameters=PARAMETERS | {"use_color": False}) as graph:
        received = one_pair(graph, messages, outputs)
    np.testing.assert_array_equal(received["depth/camera_info"].k, fused["depth/camera_info"].k)
    left = received["depth/image_rect"]
    both = [np.frombuffer(m.data, np.float32) for m in (left, fused["depth/image_rect"])]
    valid = np.isfinite(both[0]) & np.isfinite(both[1])
    assert valid.mean() > 0.5
    assert np.median(np.abs(both[0] - both[1])[valid]) == 0


def test_rectify_node_publishes_both_cameras_in_gray_and_color(camera: StereoCamera) -> None:
    topics = [f"{side}/{image}" for side in ("left", "right") for image in ("image_rect", "image_rect_color")]
    with Graph(RectifyNode) as graph:
        received = one_pair(graph, camera.pair(STAMP_NS, encoding="rgb8"), dict.fromkeys(topics, Image))
    rectifier, pair = Rectifier(camera.rig), camera.frames[0].pair
    for side, rectify, frame in (
        ("left", rectifier.rectify_left, pair.left),
        ("right", rectifier.rectify_right, pair.right),
    ):
        color = received[f"{side}/image_rect_color"]
        assert (color.encoding, color.header.frame_id, stamp_ns(color)) == ("rgb8", frame.frame_id, STAMP_NS)
        np.testing.assert_array_equal(image_pixels(color), rectify(colored(frame.pixels)))
        assert received[f"{side}/image_rect"].encoding == "mono8"


@pytest.mark.parametrize(
    ("node_type", "output", "inputs"),
    [
        (StereoDepthNode, "disparity", RAW_TOPICS),
        (RectifyNode, "right/image_rect", RAW_TOPICS),
        (DisparityNode, "disparity", ("left/image_rect", "right/image_rect", "left/camera_info", "right/camera_info")),
        (DepthNode, "depth/camera_info", ("disparity", "left/camera_info", "right/camera_info")),
        (
            PointCloudNode,
            "points2",
            ("disparity", "left/image_rect_color", "left/camera_info", "right/camera_info"),
        ),
    ],
)
def test_inputs_are_subscribed_while_an_output_is(node_type: Any, output: str, inputs: tuple[str, ...]) -> None:
    none, one = [0] * len(inputs), [1] * len(inputs)
    with Graph(node_type) as graph:
        graph.spin(0.2)
        assert graph.subscriptions(*inputs) == none
        for _ in range(2):  # a second subscriber finds what the first one found
            graph.listen(output, OUTPUTS[output])
            graph.wait(lambda: graph.subscriptions(*inputs) == one, f"subscription of {inputs}")
            graph.stop_listening(output)
            graph.wait(lambda: graph.subscriptions(*inputs) == none, f"end of the subscriptions of {inputs}")
        assert graph.status().message == "ok"


@pytest.mark.parametrize("later_ns", [30 * NS_PER_S, 0, -NS_PER_S // 2])
def test_frames_are_processed_again_after_a_pause(camera: StereoCamera, later_ns: int) -> None:
    """The same bag may be played again: its stamps are not late, and its camera infos are awaited again."""
    with Graph(StereoDepthNode, parameters=PARAMETERS) as graph:
        one_pair(graph, camera.pair(STAMP_NS), {"points2": PointCloud2})
        graph.stop_listening("points2")
        graph.wait(lambda: graph.subscriptions(*RAW_TOPICS) == [0] * 4, "end of the subscriptions")
        stamp = STAMP_NS + later_ns
        images_first = {**camera.images(stamp, index=1), **camera.infos(stamp)}
        cloud = one_pair(graph, images_first, {"points2": PointCloud2})["points2"]
    assert stamp_ns(cloud) == stamp


def test_point_cloud_without_color_needs_no_image(fused: dict[str, Any], camera: StereoCamera) -> None:
    messages = {**camera.infos(STAMP_NS), "disparity": fused["disparity"]}
    with Graph(PointCloudNode, parameters={"use_color": False}) as graph:
        cloud = one_pair(graph, messages, {"points2": PointCloud2})["points2"]
        assert graph.subscriptions("left/image_rect_color") == [0]
        assert graph.set_parameter("use_color", True, "point_cloud_node").successful
        graph.wait(lambda: graph.subscriptions("left/image_rect_color") == [1], "subscription of the color image")
    assert ([field.name for field in cloud.fields], cloud.point_step) == (["x", "y", "z"], 16)
    np.testing.assert_array_equal(cloud_values(cloud, "z"), image_pixels(fused["depth/image_rect"]))


def test_approximate_sync_pairs_within_its_tolerance(camera: StereoCamera) -> None:
    parameters = {**PARAMETERS, "approximate_sync": True, "approximate_sync_tolerance_seconds": 0.010}
    ms = 1_000_000
    with Graph(StereoDepthNode, parameters=parameters) as graph:
        received = graph.listen("disparity", DisparityImage)
        graph.send(camera.infos(STAMP_NS))
        for frame, offset_ms in enumerate((10, 11, 4, 4, 4)):  # the second is too far apart
            time_ns = STAMP_NS + frame * 100 * ms
            late = camera.images(time_ns + offset_ms * ms)
            graph.send({**camera.images(time_ns), "right/image_raw": late["right/image_raw"]})
        graph.wait(lambda: len(received) == 4, "four disparities")
        assert [stamp_ns(message) - STAMP_NS for message in received] == [0, 200 * ms, 300 * ms, 400 * ms]
        assert [graph.counter(f"unpaired {side}/image_raw") for side in ("left", "right")] == [1, 1]


def test_exact_sync_does_not_pair_a_nanosecond_apart(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=PARAMETERS) as graph:
        received = graph.listen("disparity", DisparityImage)
        messages = {**camera.pair(STAMP_NS), "right/image_raw": camera.images(STAMP_NS + 1)["right/image_raw"]}
        graph.send(messages)
        graph.send(camera.pair(STAMP_NS + NS_PER_S))
        graph.wait(lambda: received, "disparity")
        assert [stamp_ns(message) for message in received] == [STAMP_NS + NS_PER_S]


@pytest.mark.parametrize("encoding", ["mono8", "rgb8"])
def test_compressed_images_give_the_disparities_of_raw_ones(camera: StereoCamera, encoding: str) -> None:
    raw = camera.pair(STAMP_NS, encoding=encoding)
    with Graph(StereoDepthNode, parameters=PARAMETERS) as graph:
        expected = one_pair(graph, raw, {"disparity": DisparityImage})["disparity"]
    messages = camera.infos(STAMP_NS)
    for topic in ("left/image_raw", "right/image_raw"):
        header, pixels = raw[topic].header, image_pixels(raw[topic])
        messages[f"{topic}/compressed"] = compressed_message(
            camera.types, pixels, encoding, "png", STAMP_NS, header.frame_id
        )
    with Graph(StereoDepthNode, parameters={**PARAMETERS, "image_transport": "compressed"}) as graph:
        received = one_pair(graph, messages, {"disparity": DisparityImage})["disparity"]
        assert graph.subscriptions("left/image_raw", "right/image_raw") == [0, 0]
    assert received == expected


def test_namespace_and_remapping(fused: dict[str, Any], camera: StereoCamera) -> None:
    remaps = {"__ns": "/robot", "__node": "cameras", "left/image_raw": "/cameras/left", "points2": "cloud"}
    messages = {f"/robot/{topic}": message for topic, message in camera.pair(STAMP_NS).items()}
    messages["/cameras/left"] = messages.pop("/robot/left/image_raw")
    with Graph(StereoDepthNode, parameters=PARAMETERS, remaps=remaps) as graph:
        cloud = one_pair(graph, messages, {"/robot/cloud": PointCloud2})["/robot/cloud"]
        assert graph.status().name == "/robot/cameras"
    assert cloud.data == fused["points2"].data


def test_diagnostics_are_published_every_second_with_counters_and_timings(camera: StereoCamera) -> None:
    with Graph(StereoDepthNode, parameters=PARAMETERS) as graph:
        one_pair(graph, camera.pair(STAMP_NS), {"points2": PointCloud2})
        graph.diagnostics.clear()
        graph.wait(lambda: graph.diagnostics, "diagnostics", timeout_s=3.0)
        status = graph.diagnostics[0].status[0]
    values = {item.key: item.value for item in status.values}
    assert (status.name, status.level, status.message) == ("/stereo_depth_node", b"\0", "ok")
    assert values["paired"] == "1"
    stages = ("rectify", "match", "make points2", "send points2")
    assert all(float(values[f"{stage} p95 ms"]) >= float(values[f"{stage} p50 ms"]) > 0 for stage in stages)
    assert "make disparity p50 ms" not in values  # has no subscriber


NODES = ("stereo_depth_node", "rectify_node", "disparity_node", "point_cloud_node", "depth_node")


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[list[NodeProcess]]:
    """All five nodes in processes; the fused one and the separate ones in namespaces of their own."""
    started = []
    try:
        for node in NODES:
            namespace = "/fused" if node == "stereo_depth_node" else "/separate"
            started.append(NodeProcess(node, ros_arguments(PARAMETERS, {"__ns": namespace}), tmp_path))
        for process in started:
            process.wait_ready()
        yield started
    finally:
        for process in started:
            process.kill()


def assert_ended_cleanly(processes: list[NodeProcess]) -> None:
    for process in processes:
        assert process.exit_code() == 0, process.text
        assert not any(word in process.text for word in ("Traceback", "[FATAL]")), process.text


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_idle_nodes_end_with_exit_code_0(processes: list[NodeProcess], number: signal.Signals) -> None:
    for process in processes:
        process.signal(number)
    assert_ended_cleanly(processes)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_processes_agree_and_end_with_exit_code_0_while_frames_flow(
    processes: list[NodeProcess], number: signal.Signals, camera: StereoCamera
) -> None:
    topics = {f"{shape}/{topic}": OUTPUTS[topic] for shape in ("/fused", "/separate") for topic in COMPARED}
    with Graph() as graph:
        received = {topic: graph.listen(topic, kind) for topic, kind in topics.items()}
        frame, signalled = 0, False
        while any(process.running for process in processes):
            # Camera infos with every frame: what is sent while processes discover each other may be lost.
            messages = camera.pair(STAMP_NS + frame * NS_PER_S // 10, index=frame % 3)
            for shape in ("/fused", "/separate"):
                graph.send({f"{shape}/{topic}": message for topic, message in messages.items()}, subscribers=0)
            # Not faster than a busy machine works them off, until both shapes have published the same frames.
            agreed = all(common_stamps(received, topic) for topic in COMPARED)
            graph.spin(0.005 if agreed else 0.05)
            frame += 1
            assert frame < 2000, f"only {[topic for topic in topics if received[topic]]} came, or no node ended"
            if agreed and frame > 20 and not signalled:
                signalled = True
                for process in processes:
                    process.signal(number)
    assert_ended_cleanly(processes)
    for topic in COMPARED:
        fused, separate = by_stamp(received[f"/fused/{topic}"]), by_stamp(received[f"/separate/{topic}"])
        assert all(fused[stamp] == separate[stamp] for stamp in common_stamps(received, topic))


def by_stamp(messages: list[Any]) -> dict[int, Any]:
    return {stamp_ns(message): message for message in messages}


def common_stamps(received: dict[str, list[Any]], topic: str) -> set[int]:
    """Stamps of a topic that both shapes have published."""
    return set(by_stamp(received[f"/fused/{topic}"])) & set(by_stamp(received[f"/separate/{topic}"]))

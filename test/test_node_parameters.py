# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes: what is declared, what is refused at start, and what changes while running."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graph_harness import NS_PER_S, Graph, NodeProcess, StereoCamera, image_pixels, parameter_value, ros_arguments
from rcl_interfaces.msg import Parameter, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.impl.rcutils_logger import RcutilsLogger
from stereo_msgs.msg import DisparityImage

from stereo_depth_ros.config.matchers import MATCHERS, matcher_number
from stereo_depth_ros.core.errors import ConfigError, TopicError
from stereo_depth_ros.nodes.depth_node import DepthNode
from stereo_depth_ros.nodes.disparity_node import DisparityNode
from stereo_depth_ros.nodes.point_cloud_node import PointCloudNode
from stereo_depth_ros.nodes.rectify_node import RectifyNode
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode

pytestmark = pytest.mark.graph

BOOL, INT = ParameterType.PARAMETER_BOOL, ParameterType.PARAMETER_INTEGER
DOUBLE, STRING = ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_STRING
# The parameters of stereo_image_proc (Jazzy), type, default, lowest, highest, step; see also WIDER in test_config.py.
MATCHER = {
    "stereo_algorithm": (INT, 2, 0, len(MATCHERS) - 1, 1),
    "prefilter_size": (INT, 9, 5, 255, 2),
    "prefilter_cap": (INT, 31, 1, 63, 1),
    "correlation_window_size": (INT, 15, 1, 255, 2),
    "min_disparity": (INT, 0, -2048, 2048, 1),
    "disparity_range": (INT, 64, 32, 4096, 16),
    "texture_threshold": (INT, 10, 0, 10000, 1),
    "speckle_size": (INT, 100, 0, 1000, 1),
    "speckle_range": (INT, 4, 0, 31, 1),
    "disp12_max_diff": (INT, 0, 0, 128, 1),
    "sgbm_mode": (INT, 0, 0, 3, 1),
    "uniqueness_ratio": (DOUBLE, 15.0, 0.0, 100.0, 0.0),
    "P1": (DOUBLE, 200.0, 0.0, 4000.0, 0.0),
    "P2": (DOUBLE, 400.0, 0.0, 4000.0, 0.0),
}
BOTH = {
    "queue_size": (INT, 5),
    "approximate_sync": (BOOL, False),
    "approximate_sync_tolerance_seconds": (DOUBLE, 0.0),
    "image_transport": (STRING, "raw"),
    "left_camera_info_url": (STRING, ""),
    "right_camera_info_url": (STRING, ""),
}
CLOUD = {"avoid_point_cloud_padding": (BOOL, False), "use_color": (BOOL, True)}
VALUE_FIELDS = {BOOL: "bool_value", INT: "integer_value", DOUBLE: "double_value", STRING: "string_value"}
STAMP_NS = 7 * NS_PER_S
SMALL = {"disparity_range": 32, "correlation_window_size": 9}


@pytest.fixture(scope="module")
def camera() -> StereoCamera:
    return StereoCamera(frames=1)


@pytest.mark.parametrize(
    ("node_type", "name", "expected"),
    [
        (DisparityNode, "disparity_node", {**MATCHER, **BOTH}),
        (PointCloudNode, "point_cloud_node", {**CLOUD, **BOTH}),
        (StereoDepthNode, "stereo_depth_node", {**MATCHER, **CLOUD, **BOTH}),
    ],
)
def test_parameters_of_stereo_image_proc_are_declared(node_type: Any, name: str, expected: dict[str, Any]) -> None:
    with Graph(node_type) as graph:
        names = list(expected)
        values = graph.call(GetParameters, f"/{name}/get_parameters", GetParameters.Request(names=names)).values
        request = DescribeParameters.Request(names=names)
        descriptors = graph.call(DescribeParameters, f"/{name}/describe_parameters", request).descriptors
    for value, descriptor, (kind, default, *limits) in zip(values, descriptors, expected.values(), strict=True):
        assert (value.type, getattr(value, VALUE_FIELDS[kind])) == (kind, default), descriptor.name
        assert descriptor.type == kind
        assert descriptor.description.endswith((".", "]")), descriptor
        assert descriptor.read_only == (descriptor.name in BOTH)
        if limits:
            (found,) = descriptor.integer_range or descriptor.floating_point_range
            assert [found.from_value, found.to_value, found.step] == limits, descriptor.name


class Disparities:
    """The fused node and its disparities of the same pair, again and again."""

    def __init__(self, graph: Graph, camera: StereoCamera) -> None:
        self.graph = graph
        self._camera = camera
        self._received = graph.listen("disparity", DisparityImage)
        self._stamp_ns = STAMP_NS

    def next(self) -> DisparityImage:
        self._stamp_ns += NS_PER_S // 10
        self._received.clear()
        self.graph.send(self._camera.pair(self._stamp_ns))
        self.graph.wait(lambda: self._received, "disparity")
        return self._received[0]


@pytest.fixture
def running(camera: StereoCamera) -> Iterator[Disparities]:
    with Graph(StereoDepthNode, parameters=SMALL) as graph:
        yield Disparities(graph, camera)


def valid_fraction(message: DisparityImage) -> float:
    return float(np.mean(image_pixels(message.image) >= message.min_disparity))


def test_search_range_changes_at_the_next_frame(running: Disparities) -> None:
    before = running.next()
    assert running.graph.set_parameter("min_disparity", 2).successful
    assert running.graph.set_parameter("disparity_range", 48).successful
    after = running.next()
    assert after.min_disparity == pytest.approx(before.min_disparity + 2)
    assert after.max_disparity == pytest.approx(before.max_disparity + 18)
    assert after.valid_window.x_offset == before.valid_window.x_offset + 18


def test_uniqueness_changes_at_the_next_frame(running: Disparities) -> None:
    fractions = [valid_fraction(running.next())]
    for ratio in (60.0, 0.0):
        assert running.graph.set_parameter("uniqueness_ratio", ratio).successful
        fractions.append(valid_fraction(running.next()))
    assert fractions[1] < fractions[0] < fractions[2]


def test_matcher_changes_at_the_next_frame(running: Disparities) -> None:
    before = running.next()
    assert running.graph.set_parameter("stereo_algorithm", 1).successful
    assert running.next().image.data != before.image.data
    assert running.graph.set_parameter("stereo_algorithm", 2).successful
    assert running.next().image.data == before.image.data


def test_every_matcher_takes_over_at_the_next_frame(running: Disparities) -> None:
    for number, name in enumerate(MATCHERS):
        if name == "onnx":
            continue  # needs a network
        assert running.graph.set_parameter("stereo_algorithm", number).successful
        fraction = valid_fraction(running.next())
        assert fraction > (0.002 if name == "features" else 0.2), name


def test_matcher_that_lacks_something_is_refused_and_the_old_one_stays(running: Disparities) -> None:
    before = running.next()
    refused = running.graph.set_parameter("stereo_algorithm", matcher_number("onnx"))
    assert not refused.successful
    assert "onnx_model" in refused.reason
    assert running.next().image.data == before.image.data


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("disparity_range", 70, "disparity_range"),
        ("disparity_range", 16, "disparity_range"),
        ("correlation_window_size", 10, "correlation_window_size"),
        ("uniqueness_ratio", 101.0, "uniqueness_ratio"),
        ("depth_encoding", "64FC1", "depth_encoding = '64FC1' is not one of 32FC1, 16UC1: use one of them"),
        # the words of rclpy, which in ROS 2 Kilted are numbers
        ("min_disparity", "two", f"expected .*(INTEGER|'{INT}').* got .*(STRING|'{STRING}')"),
        ("queue_size", 7, "(?i)read-only"),
        ("image_transport", "compressed", "(?i)read-only"),
    ],
)
def test_refused_change_has_a_reason_and_keeps_the_value(
    running: Disparities, name: str, value: Any, reason: str
) -> None:
    before = running.next()
    old = running.graph.nodes[0].get_parameter(name).value
    result = running.graph.set_parameter(name, value)
    assert not result.successful
    assert re.search(reason, result.reason), result.reason
    assert running.graph.nodes[0].get_parameter(name).value == old
    after = running.next()
    assert (after.image.data, after.max_disparity) == (before.image.data, before.max_disparity)


def test_penalties_must_ascend_for_sgbm_only(running: Disparities) -> None:
    graph = running.graph
    for name, value in (("P1", 500.0), ("P2", 400.0)):
        assert graph.set_parameter(name, value).successful  # only sgbm has these penalties
    refused = graph.set_parameter("stereo_algorithm", 1)
    reason = "P2 = 400 is not above P1 = 500: raise P2 or lower P1 (parameters: P2, P1)"
    assert (refused.successful, refused.reason) == (False, reason)
    assert graph.set_parameter("P2", 800.0).successful
    assert graph.set_parameter("stereo_algorithm", 1).successful
    assert not graph.set_parameter("P2", 500.0).successful
    assert graph.nodes[0].get_parameter("P2").value == 800.0
    assert valid_fraction(running.next()) > 0.3


def test_atomic_change_is_accepted_or_refused_as_a_whole(running: Disparities) -> None:
    def change(**values: Any) -> Any:
        parameters = [Parameter(name=name, value=parameter_value(value)) for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        return running.graph.call(
            SetParametersAtomically, "/stereo_depth_node/set_parameters_atomically", request
        ).result

    assert not change(min_disparity=3, stereo_algorithm=1, P1=900.0, P2=400.0).successful
    unchanged = running.next()
    assert unchanged.max_disparity - unchanged.min_disparity == pytest.approx(31)
    assert unchanged.max_disparity == pytest.approx(31 - running_doffs(unchanged))
    assert change(P1=900.0, P2=1000.0, stereo_algorithm=1, min_disparity=3).successful
    assert running.next().min_disparity == pytest.approx(unchanged.min_disparity + 3)


def running_doffs(message: DisparityImage) -> float:
    """The offset of the principal points, from a message whose search begins at 0."""
    return -float(message.min_disparity)


def test_change_that_needs_larger_images_is_reported_and_can_be_undone(running: Disparities) -> None:
    graph = running.graph
    before = running.next()
    assert graph.set_parameter("stereo_algorithm", 0).successful
    assert graph.set_parameter("disparity_range", 256).successful  # nothing is wrong with the number itself
    graph.send(StereoCamera(frames=1).pair(STAMP_NS + 100 * NS_PER_S))
    graph.wait_error("images of 200 x 120 px .* needs 264 x 9 px: use a smaller search range or window")
    assert graph.counter("ImageError") == 1
    assert graph.set_parameter("disparity_range", 32).successful
    assert graph.set_parameter("stereo_algorithm", 2).successful
    running._stamp_ns = STAMP_NS + 200 * NS_PER_S
    assert running.next().image.data == before.image.data


@pytest.mark.parametrize("node_type", [StereoDepthNode, RectifyNode, DisparityNode, PointCloudNode, DepthNode])
@pytest.mark.parametrize(
    ("parameters", "remaps", "error", "text"),
    [
        (
            {"disparity_rnage": 64},
            {},
            ConfigError,
            "unknown parameter 'disparity_rnage': did you mean 'disparity_range'",
        ),
        ({"foo_bar_baz": 1}, {}, ConfigError, "unknown parameter 'foo_bar_baz': see the table of parameters"),
        ({"queue_size": 0}, {}, ConfigError, r"queue_size = 0 is outside 1\.\.1000: set it inside"),
        ({"queue_size": "'5'"}, {}, ConfigError, "queue_size = '5' is text, not a whole number"),
        ({"image_transport": "theora"}, {}, ConfigError, "'theora' is not one of raw, compressed"),
        (
            {"qos_overrides./left/image_rect.subscription.reliability": "relable"},
            {},
            ConfigError,
            r"left/image_rect\.subscription\.reliability = 'relable' is not one of .*reliable, best_effort",
        ),
        ({}, {"right/camera_info": "left/camera_info"}, TopicError, "left/camera_info and right/camera_info are both"),
    ],
)
def test_every_node_refuses_at_start(
    node_type: Any, parameters: dict[str, Any], remaps: dict[str, str], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        Graph(node_type, parameters=parameters, remaps=remaps)


@pytest.mark.parametrize(
    ("node_type", "image"),
    [(StereoDepthNode, "image_raw"), (RectifyNode, "image_raw"), (DisparityNode, "image_rect")],
)
def test_equal_image_topics_are_refused(node_type: Any, image: str) -> None:
    with pytest.raises(
        TopicError, match=f"left/{image} and right/{image} are both /camera: remap them to different topics"
    ):
        Graph(node_type, remaps={f"left/{image}": "/camera", f"right/{image}": "/camera"})


def test_parameters_of_other_stages_are_accepted() -> None:
    with Graph(DepthNode, parameters={"disparity_range": 128, "use_color": False}) as graph:
        assert not graph.nodes[0].has_parameter("disparity_range")


# As `ros2 param dump` writes them of the nodes of stereo_image_proc and image_proc, all in one section
DUMP = """
/**:
  ros__parameters:
    P1: 100.0
    P2: 600.0
    debayer: 3
    interpolation: 1
    left:
      image_rect:
        compressed: {format: jpeg, jpeg_quality: 95, png_level: 3, tiff: {res_unit: inch, xdpi: -1, ydpi: -1}}
        compressedDepth: {depth_max: 10.0, depth_quantization: 100.0, format: png, png_level: 9}
        enable_pub_plugins: [image_transport/compressed, image_transport/raw]
        theora: {keyframe_frequency: 64, optimize_for: 1, quality: 31, target_bitrate: 800000}
        zstd: {zstd_level: 3}
    qos_overrides:
      /disparity: {publisher: {depth: 1, history: keep_last, reliability: reliable}}
      /left/image_rect: {subscription: {depth: 5, history: keep_last, reliability: best_effort}}
      /parameter_events: {publisher: {depth: 1000, durability: volatile, history: keep_last, reliability: reliable}}
    queue_size: 5
    start_type_description_service: true
    use_sim_time: false
    use_system_default_qos: false
"""


@pytest.mark.parametrize("node_type", [DisparityNode, RectifyNode])
def test_parameters_of_the_replaced_nodes_are_accepted_and_named_in_one_line(node_type: Any, tmp_path: Path) -> None:
    path = tmp_path / "dump.yaml"
    path.write_text(DUMP, encoding="utf-8")
    lines: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RcutilsLogger, "info", lambda self, text, **_: lines.append(text))
        with Graph(node_type, files=[path]) as graph:
            assert not graph.nodes[0].has_parameter("interpolation")
            assert node_type is DisparityNode or graph.nodes[0].get_parameter("debayer").value == 3
            assert node_type is RectifyNode or graph.nodes[0].get_parameter("P2").value == 600.0
    (line,) = [line for line in lines if "without effect" in line]
    assert "interpolation (rectification is bilinear)" in line and "debayer" not in line
    assert "use_system_default_qos (qos_overrides set the QoS)" in line
    assert "left.image_rect.compressed.tiff.xdpi" in line and "left.image_rect.zstd.zstd_level (no image_t" in line


def test_parameters_of_other_nodes_near_a_parameter_are_still_refused() -> None:
    with pytest.raises(ConfigError, match="unknown parameter 'use_colr': did you mean 'use_color'"):
        Graph(PointCloudNode, parameters={"interpolation": 1, "use_colr": True})


def test_whole_number_at_start_is_a_double() -> None:
    with Graph(DisparityNode, parameters={"uniqueness_ratio": 20, "P1": 8}) as graph:
        values = [graph.nodes[0].get_parameter(name).value for name in ("uniqueness_ratio", "P1")]
    assert values == [20.0, 8.0]
    assert all(type(value) is float for value in values)


REFUSALS: dict[str, tuple[dict[str, Any], list[str], str]] = {
    "unknown name in a file": (
        {"disparity_rang": 64},
        [],
        "unknown parameter 'disparity_rang': did you mean 'disparity_range'?",
    ),
    "out of range": (
        {"disparity_range": 70},
        [],
        "disparity_range = 70 is not 32 plus a multiple of 16: use 64 or 80",
    ),
    "contradiction": (
        {"stereo_algorithm": 1, "P1": 500.0, "P2": 400.0},
        [],
        "P2 = 400 is not above P1 = 500: raise P2 or lower P1",
    ),
    "equal topics": (
        {},
        ros_arguments(remaps={"right/image_rect": "left/image_rect"}),
        "left/image_rect and right/image_rect are both /left/image_rect: remap them to different topics",
    ),
    "ROS argument": ({}, ["--ros-args", "-p", "min_disparity"], "check the arguments after --ros-args"),
}


@pytest.fixture(scope="module")
def refused(tmp_path_factory: pytest.TempPathFactory) -> dict[str, NodeProcess]:
    """The disparity node started with each of REFUSALS, at the same time."""
    folder = tmp_path_factory.mktemp("refused")
    processes = {}
    for name, (parameters, arguments, _) in REFUSALS.items():
        path = folder / f"{name}.yaml"
        path.write_text(json.dumps({"/**": {"ros__parameters": {"queue_size": 5, **parameters}}}), encoding="utf-8")
        extra = ros_arguments(files=[path]) if parameters else arguments
        processes[name] = NodeProcess("disparity_node", extra, Path(folder))
    return processes


@pytest.mark.parametrize("name", REFUSALS)
def test_refusal_at_start_is_one_line_and_exit_code_1(refused: dict[str, NodeProcess], name: str) -> None:
    process = refused[name]
    try:
        assert process.exit_code() == 1
    finally:
        process.kill()
    assert REFUSALS[name][2] in process.text
    assert "[FATAL]" in process.text
    assert "Traceback" not in process.text

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Help of the nodes: complete, without starting ROS; arguments that are not valid are one line."""

from __future__ import annotations

import importlib
import re
import signal
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="the nodes need ROS 2")

from documents import setup_value  # noqa: E402
from graph_harness import Graph  # noqa: E402

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane  # noqa: E402
from stereo_depth_ros.active.light_stripe.plane_file import write_plane  # noqa: E402
from stereo_depth_ros.active.structured_light.manifest import manifest_text  # noqa: E402
from stereo_depth_ros.active.structured_light.patterns import PatternSequence  # noqa: E402
from stereo_depth_ros.config import ParameterInfo, parameter_infos  # noqa: E402
from stereo_depth_ros.core.errors import ConfigError, GraphError  # noqa: E402
from stereo_depth_ros.nodes.base import StereoNode  # noqa: E402
from stereo_depth_ros.nodes.calibration_monitor import CalibrationMonitor  # noqa: E402
from stereo_depth_ros.nodes.calibration_node import CalibrationNode  # noqa: E402
from stereo_depth_ros.nodes.command_line import start_ros  # noqa: E402
from stereo_depth_ros.nodes.depth_node import DepthNode  # noqa: E402
from stereo_depth_ros.nodes.disparity_node import DisparityNode  # noqa: E402
from stereo_depth_ros.nodes.feature_node import FeatureNode  # noqa: E402
from stereo_depth_ros.nodes.interface import COMMON_OUTPUTS  # noqa: E402
from stereo_depth_ros.nodes.light_stripe_node import LightStripeNode  # noqa: E402
from stereo_depth_ros.nodes.point_cloud_node import PointCloudNode  # noqa: E402
from stereo_depth_ros.nodes.rectify_node import RectifyNode  # noqa: E402
from stereo_depth_ros.nodes.replay.graph_ports import GraphPorts  # noqa: E402
from stereo_depth_ros.nodes.replay.recorder import Recorder  # noqa: E402
from stereo_depth_ros.nodes.replay_node import INTERFACE  # noqa: E402
from stereo_depth_ros.nodes.stereo_depth_node import StereoDepthNode  # noqa: E402
from stereo_depth_ros.nodes.structured_light_node import StructuredLightNode  # noqa: E402
from stereo_depth_ros.nodes.view_node import ViewNode  # noqa: E402
from stereo_depth_ros.synthetic.rig import synthetic_rig  # noqa: E402

NODES: tuple[type[StereoNode], ...] = (
    *(RectifyNode, DisparityNode, PointCloudNode, DepthNode, StereoDepthNode, FeatureNode),
    *(ViewNode, CalibrationMonitor, CalibrationNode, StructuredLightNode, LightStripeNode),
)
INTERFACES = {node.interface.name: node.interface for node in NODES} | {INTERFACE.name: INTERFACE}
OF_ROS = ("/rosout", "/parameter_events")


@pytest.fixture
def no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    def started(*_: Any, **__: Any) -> None:
        raise AssertionError("ROS was started")

    monkeypatch.setattr(rclpy, "init", started)
    monkeypatch.setattr("stereo_depth_ros.nodes.runner.prepare_process", started)
    monkeypatch.setattr("stereo_depth_ros.nodes.replay_node.prepare_process", started)


def help_of(node: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> str:
    monkeypatch.setattr(sys, "argv", [node, *arguments])
    assert importlib.import_module(f"stereo_depth_ros.nodes.{node}").main() == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


def section(text: str, title: str) -> dict[str, str]:
    """The names and types of a section of the help."""
    found = re.search(rf"^{title}:\n((?:  .+\n)*)", text, re.MULTILINE)
    return dict(line.split() for line in found[1].splitlines()) if found else {}  # type: ignore[misc]


def test_every_executable_has_an_interface() -> None:
    assert INTERFACES.keys() == set(setup_value("NODES"))


@pytest.mark.parametrize("node", setup_value("NODES"))
def test_help_names_topics_services_and_parameters(
    node: str, no_ros: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text, interface = help_of(node, capsys, monkeypatch, "--help"), INTERFACES[node]
    assert text.startswith(f"Usage: ros2 run stereo_depth_ros {node} [-h] [--ros-args ...]\n\n  ")
    assert section(text, "Subscribed topics") == interface.inputs
    common = {} if node == "replay_node" else COMMON_OUTPUTS
    assert section(text, "Published topics") == {**interface.outputs, **common}
    assert section(text, "Services") == interface.services
    assert section(text, "Services called") == interface.clients
    words = " ".join(text.split())
    for config in interface.configs:
        for info in parameter_infos(config):
            assert f"{' '.join(facts(info).split())} {info.doc}" in words
    assert f"ros2 run stereo_depth_ros {node} --ros-args -p NAME:=VALUE" in text
    assert ("while one of its outputs has a subscriber" in words) is interface.lazy
    about = text.split("\n\n")[1].split()
    assert about[0].endswith("s") and about[-1].endswith("."), "a sentence on what the node does"


def facts(info: ParameterInfo) -> str:
    """The line of a parameter: its name, type, default and range, and whether it is fixed at start."""
    default = {bool: str(info.default).lower(), str: f'"{info.default}"'}.get(info.type, str(info.default))
    ranges = f"; {info.range_text}" if info.range_text else ""
    return f"{info.name}: {info.ros_type}; default {default}{ranges}{'' if info.run_time else '; fixed at start'}"


@pytest.mark.parametrize("arguments", [("-h",), ("--ros-args", "--help"), ("--ros-args", "-p", "bag:=a", "-h")])
def test_help_is_also_asked_for_by(
    arguments: tuple[str, ...], no_ros: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for node in ("disparity_node", "replay_node"):
        assert help_of(node, capsys, monkeypatch, *arguments).startswith("Usage: ")


def test_nothing_that_is_fixed_is_offered_for_change(
    no_ros: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "ros2 param set" not in help_of("replay_node", capsys, monkeypatch, "-h")
    assert "ros2 param set /disparity_node NAME VALUE" in help_of("disparity_node", capsys, monkeypatch, "-h")


@pytest.fixture
def shut_down() -> Iterator[None]:
    yield
    rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--foo"], "unknown argument --foo: give parameters and topics after --ros-args, see --help"),
        (["a", "--ros-args", "-p", "queue_size:=4", "--", "b"], "unknown argument a b: give"),
        (["--ros-args", "--foo"], "unknown ROS argument --foo: see --help"),
        (["--ros-args", "-p", "x"], "ROS does not start: .*Couldn't parse parameter override rule: '-p x'"),
        (["--ros-args", "-r", "a"], "ROS does not start: .*Couldn't parse remap rule: '-r a'"),
        (["--ros-args", "-p"], "ROS does not start: .*Couldn't parse trailing -p flag"),
        (["--ros-args", "--params-file", "/none"], "ROS does not start: .*Couldn't parse params file"),
        (["--ros-args", "--log-level", "loud"], "ROS does not start: .*Couldn't parse log level"),
    ],
)
def test_arguments_that_are_not_valid_are_one_line(arguments: list[str], problem: str, shut_down: None) -> None:
    with pytest.raises(GraphError, match=f"^{problem}") as raised:
        start_ros(["stereo_depth_node", *arguments])
    text = str(raised.value)
    assert "\n" not in text
    assert not re.search(r"\.c(pp)?:\d+", text), "lines of the source of rcl"


@pytest.mark.parametrize("node", ["disparity_node", "replay_node"])
def test_a_node_ends_with_one_line_and_exit_code_1(
    node: str, shut_down: None, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = signal.getsignal(signal.SIGINT)
    for module in ("runner", "replay_node"):
        monkeypatch.setattr(f"stereo_depth_ros.nodes.{module}.prepare_process", lambda: None)
    monkeypatch.setattr(sys, "argv", [node, "--ros-args", "--foo"])
    try:
        assert importlib.import_module(f"stereo_depth_ros.nodes.{node}").main() == 1
    finally:
        signal.signal(signal.SIGINT, before)
    (line,) = capfd.readouterr().err.splitlines()
    assert line.endswith("unknown ROS argument --foo: see --help")


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--ros-args"],
        ["--ros-args", "-p", "queue_size:=4", "-r", "__node:=left", "--"],
        ["--ros-args", "-r", "a:=b"],
    ],
)
def test_arguments_of_ros_start_it(arguments: list[str], shut_down: None) -> None:
    start_ros(["stereo_depth_node", *arguments])
    assert rclpy.ok()


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("use_sim_time", 3, "parameter 'use_sim_time' to '3' of type 'INTEGER', expecting type 'BOOL'"),
        ("start_type_description_service", "maybe", "expecting type 'BOOL'"),
        ("qos_overrides./points2.publisher.depth", "deep", "depth = 'deep' is not a whole number of messages"),
        ("qos_overrides./left/image_raw.subscription.depth", -3, "depth = -3 is not a whole number of messages"),
    ],
)
@pytest.mark.graph
def test_parameters_of_ros_are_checked_at_start(name: str, value: Any, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem), Graph(StereoDepthNode, parameters={name: value}):
        pass


def types(endpoints: Any) -> dict[str, str]:
    """Type by topic of publishers or subscriptions, without those of ROS itself."""
    named = {
        end.topic_name: f"{end.msg_type.__module__.split('.')[0]}/msg/{end.msg_type.__name__}" for end in endpoints
    }
    return {topic: msgtype for topic, msgtype in named.items() if topic not in OF_ROS}


def absolute(topics: Mapping[str, str]) -> dict[str, str]:
    return {f"/{topic.lstrip('/')}": msgtype for topic, msgtype in topics.items() if not topic.startswith("~")}


@pytest.fixture
def with_all_topics(tmp_path: Path) -> dict[str, Any]:
    """Parameters with which every node starts, and has as many topics as it can have at once."""
    write_plane(tmp_path / "laser.yaml", LightPlane.exact(np.array([1.0, 0.2, -0.3]), 0.4), synthetic_rig(64, 48).left)
    (tmp_path / "patterns.json").write_text(manifest_text(PatternSequence.of_kind("gray", (64, 48))), "utf-8")
    return {
        **{"auto_correct": True, "patterns": str(tmp_path / "patterns.json"), "pattern_signal": "topic"},
        **{"laser_file": str(tmp_path / "laser.yaml"), "stripe_motion": "pose", "range_sensor": "/points"},
        "point_quality": True,
    }


@pytest.mark.graph
def test_a_live_node_has_the_topics_of_its_interface(with_all_topics: dict[str, Any]) -> None:
    for node_type in NODES:
        with Graph(node_type, parameters=with_all_topics) as graph:
            (node,) = graph.nodes
            inputs = {topic: kind for topic, kind in node.interface.inputs.items() if topic != "joint_states"}
            published = types(node.publishers)
            assert published == absolute({**node.interface.outputs, **COMMON_OUTPUTS})
            for publisher in node.publishers:
                if publisher.topic_name in published.keys() - {"/diagnostics"}:
                    graph.listen(publisher.topic_name, publisher.msg_type)
            graph.wait(lambda: len(types(node.subscriptions)) == len(inputs), "inputs")  # noqa: B023
            assert types(node.subscriptions) == absolute(inputs)  # one of two kinds of motion
            own = {service.srv_name for service in node.services if service.srv_name.startswith("~")}
            assert own == set(node.interface.services)


@pytest.mark.graph
def test_a_live_replay_has_the_topics_of_its_interface() -> None:
    with Graph() as graph:
        node = rclpy.create_node(INTERFACE.name)
        graph.nodes.append(node)
        GraphPorts(node, Recorder(None), compressed=False, clock=True).close()
        # close() has unsubscribed the outputs
        assert types(node.publishers) == absolute(INTERFACE.outputs)
        left = types(node.subscriptions)
        assert left.items() <= absolute(INTERFACE.inputs).items()


@pytest.mark.graph
def test_the_log_names_inputs_qos_matcher_and_what_the_node_waits_for() -> None:
    override = {"qos_overrides./left/image_raw.subscription.reliability": "reliable", "queue_size": 7}
    with Graph(
        StereoDepthNode, FeatureNode, parameters={**override, "stereo_algorithm": 0}, remaps={"disparity": "/d"}
    ) as graph:
        fused, features = graph.nodes
        assert fused.readiness() == [
            "inputs: /left/camera_info, /right/camera_info (best effort unless latched, depth 7); "
            "/left/image_raw (reliable, depth 7); /right/image_raw (reliable as its publishers, depth 7)",
            "ready; matcher bm; waiting for a subscriber of /d, /depth/image_rect, /depth/camera_info, /points2, "
            "/left/image_rect, /left/image_rect_color, /right/image_rect, /right/image_rect_color, /confidence, "
            "/confidence_mono8, /reasons_color, /error_disparity, /error_depth",
        ]
        assert features.readiness()[1] == "ready; matcher features; waiting for a subscriber of /features/points2"


@pytest.mark.graph
def test_the_log_of_a_node_that_does_not_wait() -> None:
    with Graph(CalibrationNode, parameters={"image_transport": "compressed"}) as graph:
        assert graph.nodes[0].readiness() == [
            "inputs: /left/image_raw/compressed, /right/image_raw/compressed (reliable as its publishers, depth 5)",
            "ready; publishing /calibration/image",
        ]

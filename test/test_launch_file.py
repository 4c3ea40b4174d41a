# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The launch file names executables and parameters that exist; ``launch`` itself is replaced by recorders."""

from __future__ import annotations

import dataclasses
import runpy
import sys
import types
from pathlib import Path
from typing import Any

import pytest
import setuptools

from stereo_depth_ros.config import CalibrationMonitorConfig, MatchingConfig, PipelineConfig, parameter_infos
from stereo_depth_ros.core.errors import ConfigError

ROOT = Path(__file__).resolve().parents[1]

LAUNCH_NAMES = {
    "launch": ["LaunchDescription"],
    "launch.actions": ["DeclareLaunchArgument", "GroupAction", "LogInfo", "OpaqueFunction"],
    "launch.conditions": ["IfCondition", "UnlessCondition"],
    "launch.substitutions": ["LaunchConfiguration", "PythonExpression"],
    "launch_ros": [],
    "launch_ros.actions": ["Node"],
    "launch_ros.parameter_descriptions": ["ParameterValue"],
}


class Recorder:
    """Replaces any class of ``launch`` and keeps its arguments."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.kwargs = args, kwargs


def recorders() -> dict[str, types.ModuleType]:
    modules = {}
    for name, classes in LAUNCH_NAMES.items():
        modules[name] = types.ModuleType(name)
        for class_name in classes:
            setattr(modules[name], class_name, type(class_name, (Recorder,), {}))
    return modules


def launched(monkeypatch: pytest.MonkeyPatch, **arguments: str) -> list[Any]:
    """All actions with these arguments, those of groups and functions included, in the order of launch."""
    for name, module in recorders().items():
        monkeypatch.setitem(sys.modules, name, module)
    description = runpy.run_path(str(ROOT / "launch" / "stereo_depth.launch.py"))["generate_launch_description"]()
    context = types.SimpleNamespace(launch_configurations=dict(arguments))
    pending, found = list(description.args[0]), []
    while pending:
        entity = pending.pop(0)
        found.append(entity)
        if type(entity).__name__ == "DeclareLaunchArgument":
            context.launch_configurations.setdefault(entity.args[0], entity.kwargs["default_value"])
        elif type(entity).__name__ == "OpaqueFunction":
            pending[:0] = entity.kwargs["function"](context, *entity.kwargs.get("args", ())) or []
        elif type(entity).__name__ == "GroupAction":
            pending += entity.args[0]
    return found


@pytest.fixture
def entities(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """All actions without arguments."""
    return launched(monkeypatch)


def of_type(entities: list[Any], name: str) -> list[Any]:
    return [entity for entity in entities if type(entity).__name__ == name]


def nodes_of(entities: list[Any]) -> dict[str, Any]:
    return {node.kwargs["executable"]: node for node in of_type(entities, "Node")}


def configuration_name(substitution: Any) -> str:
    assert type(substitution).__name__ == "LaunchConfiguration"
    return str(substitution.args[0])


def entry_points(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Names of the executables that setup.py installs."""
    recorded: dict[str, Any] = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(setuptools, "setup", lambda **kwargs: recorded.update(kwargs))
    runpy.run_path("setup.py")
    assert recorded["name"] == "stereo_depth_ros"
    return {line.split("=")[0].strip() for line in recorded["entry_points"]["console_scripts"]}


def test_every_argument_of_the_contract_is_declared_once(entities: list[Any]) -> None:
    declared = [argument.args[0] for argument in of_type(entities, "DeclareLaunchArgument")]
    contract = {
        *("approximate_sync", "avoid_point_cloud_padding", "use_color", "launch_image_proc", "namespace"),
        *("left_namespace", "right_namespace", "container", "fused"),
        *(info.name for info in parameter_infos(MatchingConfig)),
    }
    assert contract <= set(declared)
    assert len(declared) == len(set(declared))


def test_argument_defaults(entities: list[Any]) -> None:
    defaults = {
        argument.args[0]: argument.kwargs["default_value"] for argument in of_type(entities, "DeclareLaunchArgument")
    }
    assert all(isinstance(value, str) for value in defaults.values()), "launch takes text"
    expected = {
        **{"launch_image_proc": "true", "left_namespace": "left", "right_namespace": "right", "container": ""},
        **{"fused": "false", "uniqueness_ratio": "15.0", "disparity_range": "64", "use_color": "True"},
    }
    assert {name: defaults[name] for name in expected} == expected


def test_executables_are_installed(entities: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = nodes_of(entities)
    assert set(nodes) == {
        *(
            "rectify_node",
            "disparity_node",
            "point_cloud_node",
            "depth_node",
            "stereo_depth_node",
            "calibration_monitor",
        )
    }
    assert set(nodes) < entry_points(monkeypatch)
    assert {node.kwargs["package"] for node in nodes.values()} == {"stereo_depth_ros"}


def test_parameters_are_those_of_the_stages_with_their_types(entities: list[Any]) -> None:
    stages = {
        item.name: {info.name: info.type for info in parameter_infos(item.default)}
        for item in dataclasses.fields(PipelineConfig)
    }
    expected = {
        "rectify_node": {**stages["pairing"], **stages["rectification"]},
        "disparity_node": {**stages["pairing"], **stages["matching"]},
        "point_cloud_node": {**stages["pairing"], **stages["cloud"]},
        "depth_node": {**stages["pairing"], **stages["depth"]},
        "stereo_depth_node": {name: kind for stage in stages.values() for name, kind in stage.items()},
        "calibration_monitor": {
            **stages["pairing"],
            **{info.name: info.type for info in parameter_infos(CalibrationMonitorConfig)},
        },
    }
    for executable, node in nodes_of(entities).items():
        (parameters,) = node.kwargs["parameters"]
        assert {name: value.kwargs["value_type"] for name, value in parameters.items()} == expected[executable]
        if executable not in ("rectify_node", "stereo_depth_node"):
            parameters = {name: value for name, value in parameters.items() if name != "image_transport"}
        assert all(configuration_name(value.args[0]) == name for name, value in parameters.items())


@pytest.mark.parametrize(
    ("launch_image_proc", "asked", "expected"),
    [("true", "compressed", "raw"), ("True", "compressed", "raw"), ("false", "compressed", "compressed")],
)
def test_compressed_is_requested_of_the_cameras_only(
    entities: list[Any], launch_image_proc: str, asked: str, expected: str
) -> None:
    (parameters,) = nodes_of(entities)["disparity_node"].kwargs["parameters"]
    given = {"launch_image_proc": launch_image_proc, "image_transport": asked}
    parts = parameters["image_transport"].args[0].args[0]
    expression = "".join(part if isinstance(part, str) else given[configuration_name(part)] for part in parts)
    assert eval(expression) == expected


def test_camera_topics_follow_the_namespaces(entities: list[Any]) -> None:
    for executable, node in nodes_of(entities).items():
        assert configuration_name(node.kwargs["namespace"]) == "namespace"
        targets = dict(node.kwargs["remappings"])
        if executable in ("rectify_node", "stereo_depth_node"):
            assert configuration_name(targets.pop("right/camera_info")[0]) == "right_namespace"
        else:
            targets.pop("right/camera_info")
        remappings = {source: configuration_name(target[0]) + target[1] for source, target in targets.items()}
        assert remappings == {
            "left/camera_info": "left_namespace/camera_info",
            "right/camera_info_corrected": "right_namespace/camera_info_corrected",
        } | {
            f"{side}/{topic}": f"{side}_namespace/{topic}"
            for side in ("left", "right")
            for name in ("image_raw", "image_rect", "image_rect_color")
            for topic in (name, f"{name}/compressed")
        } | {
            f"{side}/{name}": f"{side}_namespace/{name}"
            for side in ("left", "right")
            for name in ("image_mono", "image_color")
        }


@pytest.mark.parametrize(
    ("health", "auto_correct", "expected"),
    [("true", "True", "/camera_info_corrected"), ("true", "false", "/camera_info"), ("false", "true", "/camera_info")],
)
def test_corrected_camera_infos_go_to_the_nodes_that_rectify(
    entities: list[Any], health: str, auto_correct: str, expected: str
) -> None:
    given = {"health": health, "auto_correct": auto_correct}
    for executable, node in nodes_of(entities).items():
        target = dict(node.kwargs["remappings"])["right/camera_info"][1]
        if executable in ("rectify_node", "stereo_depth_node"):
            parts = target.args[0]
            text = "".join(part if isinstance(part, str) else given[configuration_name(part)] for part in parts)
            assert eval(text) == expected
        else:
            assert target == "/camera_info"


def test_one_shape_or_the_other(entities: list[Any]) -> None:
    (group,) = of_type(entities, "GroupAction")
    separate = {node.kwargs["executable"]: node.kwargs["condition"] for node in group.args[0]}
    assert set(separate) == {"rectify_node", "disparity_node", "point_cloud_node", "depth_node"}
    assert type(group.kwargs["condition"]).__name__ == "UnlessCondition"
    assert configuration_name(group.kwargs["condition"].args[0]) == "fused"
    assert configuration_name(separate.pop("rectify_node").args[0]) == "launch_image_proc"
    assert set(separate.values()) == {None}
    fused = nodes_of(entities)["stereo_depth_node"].kwargs["condition"]
    assert type(fused).__name__ == "IfCondition"
    assert configuration_name(fused.args[0]) == "fused"


def test_a_container_is_answered_with_a_word(entities: list[Any]) -> None:
    (info,) = of_type(entities, "LogInfo")
    parts = info.kwargs["condition"].args[0].args[0]
    text = "".join(part if isinstance(part, str) else part.args[0] for part in parts)
    assert text == "'container' != ''"
    assert "is not used" in info.kwargs["msg"][-1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"disparity_range": "abc"},
            "parameter disparity_range = 'abc' is text, not a whole number: write a whole number, ",
        ),
        ({"disparity_range": "70"}, "disparity_range = 70 is not 32 plus a multiple of 16: use 64 or 80"),
        ({"use_color": "maybe"}, "parameter use_color = 'maybe' is text, not true or false"),
        ({"row_error_limit": "[1"}, r"parameter row_error_limit: '\[1' is not a value"),
        ({"stereo_algorithm": "1", "P1": "500.0"}, "P2 = 400 is not above P1 = 500"),
        ({"health": "maybe"}, "argument health = 'maybe' is not one of true, false, 1, 0: use one of them"),
        ({"log_level": "loud"}, "argument log_level = 'loud' is not one of debug, info"),
        ({"params_file": "/none.yaml"}, "/none.yaml: does not exist: name a YAML file of ROS parameters"),
    ],
)
def test_wrong_arguments_are_named_before_a_node_starts(
    monkeypatch: pytest.MonkeyPatch, arguments: dict[str, str], message: str
) -> None:
    """The error leaves the function that makes the nodes, so that launch has none to start."""
    with pytest.raises(ConfigError, match=message):
        launched(monkeypatch, **arguments)


def test_values_of_all_types_are_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = {"disparity_range": "128", "P1": "8", "use_color": "False", "depth_encoding": "16UC1", "fused": "True"}
    assert nodes_of(launched(monkeypatch, **arguments))


FILE = """
/**: {ros__parameters: {use_sim_time: true, disparity_range: 96, min_disparity: 3, interpolation: 1}}
camera_driver: {ros__parameters: {exposure: 5}}
/head/disparity_node:
  ros__parameters: {disparity_range: 128, qos_overrides: {/x: {publisher: {depth: 1}}}, image_transport: compressed}
head: {rectify_node: {ros__parameters: {queue_size: 9, image_transport: compressed}}}
"""


def test_nodes_take_their_sections_of_the_file_under_the_arguments(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(FILE)

    def values(executable: str, **arguments: str) -> dict[str, Any]:
        """The values that are not those of the arguments."""
        found = nodes_of(launched(monkeypatch, params_file=str(path), namespace="/head", **arguments))
        (parameters,) = found[executable].kwargs["parameters"]
        items = {name: value.args[0] for name, value in parameters.items()}
        return {name: item for name, item in items.items() if not isinstance(item, Recorder)}

    qos = {"qos_overrides./x.publisher.depth": 1}
    search = {"use_sim_time": True, "disparity_range": 128, "min_disparity": 3, **qos}
    assert values("disparity_node") == search
    assert values("disparity_node", launch_image_proc="false") == {**search, "image_transport": "compressed"}
    assert values("disparity_node", disparity_range="64", use_sim_time="false") == {"min_disparity": 3, **qos}
    assert values("rectify_node") == {"use_sim_time": True, "queue_size": 9, "image_transport": "compressed"}
    assert values("stereo_depth_node") == {**search, "queue_size": 9, "image_transport": "compressed"}
    assert values("point_cloud_node") == {"use_sim_time": True}


def test_simulated_time_and_log_level_reach_every_node(monkeypatch: pytest.MonkeyPatch) -> None:
    for node in nodes_of(launched(monkeypatch, use_sim_time="True")).values():
        (parameters,) = node.kwargs["parameters"]
        assert parameters["use_sim_time"].args[0] is True
        option, level = node.kwargs["ros_arguments"]
        assert (option, configuration_name(level)) == ("--log-level", "log_level")

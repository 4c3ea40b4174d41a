# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters as texts and files, and their errors."""

from __future__ import annotations

from pathlib import Path

import pytest
from documentation import render_yaml

from stereo_depth_ros.config.values import parse_assignments, pipeline_config, read_params_file
from stereo_depth_ros.core.errors import ConfigError


def test_assignments_become_values_of_the_parameters_types() -> None:
    texts = ["disparity_range:=128", "uniqueness_ratio:=5", "use_color:=false", "depth_encoding:=16UC1"]
    values = parse_assignments(texts, matcher="sgbm")
    assert values == {
        "stereo_algorithm": 1,
        "disparity_range": 128,
        "uniqueness_ratio": 5.0,
        "use_color": False,
        "depth_encoding": "16UC1",
    }
    assert type(values["uniqueness_ratio"]) is float
    config = pipeline_config(values)
    assert config.matching.num_disparities == 128
    assert config.matching.stereo_algorithm == 1
    assert config.cloud.use_color is False
    assert config.depth.depth_encoding == "16UC1"


@pytest.mark.parametrize(
    ("texts", "matcher", "message"),
    [
        (["disparity_range=128"], None, "'disparity_range=128' is not of the form name:=value"),
        (["disparity_rang:=128"], None, "unknown parameter 'disparity_rang': did you mean 'disparity_range'"),
        (["zzz:=1"], None, "unknown parameter 'zzz': see the table of parameters"),
        (["disparity_range:=130"], None, "disparity_range = 130 .* use 128 or 144"),
        (["disparity_range:=[1"], None, r"disparity_range: '\[1' is not a value"),
        ([], "census", "matcher 'census' is not one of bm, sgbm"),
    ],
)
def test_errors_of_assignments(texts: list[str], matcher: str | None, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_assignments(texts, matcher)


def test_generated_parameter_file_holds_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "stereo_depth.yaml"
    path.write_text(render_yaml())
    assert pipeline_config(read_params_file(path)) == pipeline_config({})


def test_sections_of_several_nodes_are_merged(tmp_path: Path) -> None:
    path = tmp_path / "nodes.yaml"
    path.write_text(
        "disparity_node:\n  ros__parameters: {disparity_range: 96, use_sim_time: true}\n"
        "point_cloud_node:\n  ros__parameters: {use_color: false}\n"
    )
    assert read_params_file(path) == {"disparity_range": 96, "use_color": False}


ROBOT = """
camera_driver:
  ros__parameters: {exposure: 5, rates: [1.0, 2.0]}
arm:
  gripper: {ros__parameters: {P1: 7.0}}
/**:
  ros__parameters: {use_sim_time: true, min_disparity: 1, disparity_range: 48}
/front/disparity_node:
  ros__parameters: {disparity_range: 256}
disparity_node:
  ros__parameters:
    disparity_range: 96
    qos_overrides: {/disparity: {publisher: {depth: 1, reliability: reliable}}}
/**/point_cloud_node: {ros__parameters: {use_color: false}}
/*: {ros__parameters: {min_disparity: 2}}
"""


def test_sections_of_other_nodes_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    assert read_params_file(path) == {"min_disparity": 2, "disparity_range": 96, "use_color": False}
    assert read_params_file(path, ["depth_node"]) == {"min_disparity": 2, "disparity_range": 48}
    path.write_text("camera_driver:\n  ros__parameters: {exposure: 5}\n")
    assert read_params_file(path) == {}


def test_parameters_of_the_nodes_of_stereo_image_proc_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "dump.yaml"
    path.write_text(
        "/**:\n  ros__parameters:\n    P1: 200.0\n    approximate_sync: true\n    debayer: 3\n    interpolation: 1\n"
        "    left: {image_rect: {compressed: {format: jpeg, tiff: {xdpi: -1}}, enable_pub_plugins: [a, b]}}\n"
        "    qos_overrides: {/parameter_events: {publisher: {depth: 1000, history: keep_last}}}\n"
        "    start_type_description_service: true\n    use_system_default_qos: false\n    queue_size: 5\n"
    )
    assert read_params_file(path) == {"P1": 200.0, "approximate_sync": True, "debayer": 3, "queue_size": 5}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("/**:\n  ros__parameters: {interpolatoin: 1}\n", "unknown parameter 'interpolatoin'"),
        ("/**:\n  ros__parameters: {left: {image_rect: {gain: 1}}}\n", "unknown parameter 'left.image_rect.gain'"),
        ("/**:\n  ros__parameters: {P1: }\n", "parameter P1 has no value: write a value"),
        ("ns:\n  /node: {ros__parameters: {P1: 1.0}}\n", "section '/ns//node' is not the name of a node"),
        ("depth_*: {ros__parameters: {P1: 1.0}}\n", r"section '/depth_\*' is not the name of a node"),
        ("/**: {ros__parameters: }\n", "is not a parameter file: write node names"),
        ("", "is not a parameter file: write node names"),
        ("disparity_range: 64\n", "is not a parameter file: write node names"),
        ("/**: [", r"is not a parameter file \(expected .* in line 1"),
        ("/**:\n  ros__parameters: {speckle: 3}\n", "unknown parameter 'speckle': did you mean 'speckle_size'"),
    ],
)
def test_errors_name_the_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"p\.yaml: {message}") as caught:
        read_params_file(path)
    assert caught.value.subject == str(path)
    with pytest.raises(ConfigError, match=r"none\.yaml: does not exist: name a YAML file"):
        read_params_file(tmp_path / "none.yaml")

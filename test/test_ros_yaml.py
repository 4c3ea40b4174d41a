# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files and values give what rclpy makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from stereo_depth_ros.config.ros_yaml import node_parameters, parse_value

rclpy = pytest.importorskip("rclpy", reason="compared with rclpy")
pytestmark = pytest.mark.graph

FILES = [
    "stereo_depth_node: {ros__parameters: {a: 1}}\n/**: {ros__parameters: {a: 2, b: 3}}\n",  # the later section counts
    "/**: {ros__parameters: {a: 1}}\nstereo_depth_node: {ros__parameters: {a: 2}}\n/**: {ros__parameters: {a: 3}}\n",
    "/stereo_depth_node: {ros__parameters: {a: 1}}\nstereo_depth_node: {ros__parameters: {a: 2}}\n",
    "/*: {ros__parameters: {a: 1}}\n/*/stereo_depth_node: {ros__parameters: {a: 2}}\n",
    "/**/stereo_depth_node: {ros__parameters: {a: 1}}\n/**/*: {ros__parameters: {b: 1}}\n",
    "/**:\n  stereo_depth_node: {ros__parameters: {a: 1}}\n",
    "front/stereo_depth_node: {ros__parameters: {a: 1}}\nfront: {stereo_depth_node: {ros__parameters: {b: 1}}}\n",
    "/front/**: {ros__parameters: {a: 1}}\n/front/*: {ros__parameters: {b: 1}}\n",
    "depth_node: {ros__parameters: {a: 1}}\nstereo: {ros__parameters: {b: 1}}\n",
    "/**: {ros__parameters: {a: {b: {c: 1}, d: 2}, 'e.f': 3, g: [1, 2], h: [yes, no], 'i./j.k': x}}\n",
    "/**: {ros__parameters: {a: 1}}\n---\n/**: {ros__parameters: {b: 1}}\n",
]
VALUES = [
    *("yes", "on", "Y", "TRUE", "off", "n", "5", "+5", "-5", "0", "-0", "010", "0x1F", "08", "99999999999999999999"),
    *("1.", ".5", "1e3", "-2.5E-3", ".inf", "-.INF", "1e400", "1_000", "0o17", "~", "null", "'5'", '"yes"', "''"),
    *("2024-01-01", "1:30", "a b", "[1, 2]", "[a, '1']"),
]


@pytest.fixture
def context() -> Iterator[Any]:
    context = rclpy.Context()
    yield context
    context.try_shutdown()


def ros_parameters(context: Any, path: Path, namespace: str = "") -> dict[str, Any]:
    """What a stereo_depth_node of rclpy takes from the file."""
    rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
    node = rclpy.create_node("stereo_depth_node", namespace=namespace, context=context, enable_rosout=False)
    values = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    node.destroy_node()
    return {name: list(value) if isinstance(value, (list, tuple)) else value for name, value in values.items()}


@pytest.mark.parametrize("text", FILES)
@pytest.mark.parametrize("namespace", ["", "front"])
def test_sections_apply_as_in_ros(context: Any, tmp_path: Path, text: str, namespace: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(text, encoding="utf-8")
    name = f"{namespace}/stereo_depth_node".strip("/")
    assert node_parameters(path, name) == ros_parameters(context, path, namespace)


def test_values_have_the_types_of_ros(context: Any, tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    lines = [f"    p{number}: {text}\n" for number, text in enumerate(VALUES)]
    path.write_text("/**:\n  ros__parameters:\n" + "".join(lines), encoding="utf-8")
    expected = ros_parameters(context, path)
    found = node_parameters(path, "stereo_depth_node")
    assert {name: (type(value), value) for name, value in found.items()} == {
        name: (type(value), value) for name, value in expected.items()
    }
    assert [parse_value("p", text) for text in VALUES] == list(found.values())

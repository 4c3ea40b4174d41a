# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interface of a node: topics, services and parameters, from which the node is made and its help is written."""

from __future__ import annotations

import inspect
import json
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from stereo_depth_ros.config import ParameterInfo, parameter_infos

__all__ = ["CAMERA_INFOS", "COMMON_OUTPUTS", "RAW_IMAGES", "RECTIFIED_IMAGES", "NodeInterface", "transported"]

_WIDTH = 100
_INFO, _IMAGE = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image"
CAMERA_INFOS = {"left/camera_info": _INFO, "right/camera_info": _INFO}
RAW_IMAGES = {"left/image_raw": _IMAGE, "right/image_raw": _IMAGE}
RECTIFIED_IMAGES = {"left/image_rect": _IMAGE, "right/image_rect": _IMAGE}
# of every node but replay_node
COMMON_OUTPUTS = {"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "~/ready": "std_msgs/msg/Int64"}


def transported(topic: str, msgtype: str, compressed: bool) -> tuple[str, str]:
    """Topic and type by image_transport: those of compressed images differ, all others stay."""
    if compressed and msgtype == _IMAGE:
        return f"{topic}/compressed", "sensor_msgs/msg/CompressedImage"
    return topic, msgtype


@dataclass(frozen=True)
class NodeInterface:
    """The topics, services and parameters of a node; names are relative to its namespace.

    Attributes:
        name: of the node and of its executable.
        configs: config classes whose parameters it declares.
        inputs, outputs: type by topic, subscribed and published.
        services, clients: type by service, offered and called.
        lazy: the inputs are subscribed only while an output has a subscriber.
    """

    name: str
    configs: tuple[type, ...]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    services: Mapping[str, str] = field(default_factory=dict)
    clients: Mapping[str, str] = field(default_factory=dict)
    lazy: bool = True

    def help(self, about: str) -> str:
        """The text of ``--help``, which begins with ``about``, paragraphs on what the node does."""
        paragraphs = [" ".join(text.split()) for text in inspect.cleandoc(about).split("\n\n")]
        if self.lazy:
            paragraphs.append("It subscribes to its inputs while one of its outputs has a subscriber.")
        parts = [
            f"Usage: ros2 run stereo_depth_ros {self.name} [-h] [--ros-args ...]",
            *(textwrap.fill(text, _WIDTH, initial_indent="  ", subsequent_indent="  ") for text in paragraphs),
            *_section("Subscribed topics", self.inputs),
            *_section("Published topics", self.outputs),
            *_section("Services", self.services),
            *_section("Services called", self.clients),
            "\n".join(["Parameters:", *(line for config in self.configs for line in _parameters(config))]),
            "\n".join(["Set parameters and topics with:", *self._ways_to_set()]),
        ]
        return "\n\n".join(parts) + "\n"

    def _ways_to_set(self) -> Iterator[str]:
        start = f"  ros2 run stereo_depth_ros {self.name} --ros-args"
        yield f"{start} -p NAME:=VALUE"
        yield f"{start} --params-file FILE.yaml"
        yield f"{start} -r TOPIC:=OTHER"
        if any(info.run_time for config in self.configs for info in parameter_infos(config)):
            yield f"  ros2 param set /{self.name} NAME VALUE  (while it runs, unless the parameter is fixed at start)"


def _section(title: str, types: Mapping[str, str]) -> Iterator[str]:
    """A title and a line for each name; nothing without names."""
    if types:
        width = max(map(len, types))
        yield "\n".join([f"{title}:", *(f"  {name:{width}}  {msgtype}" for name, msgtype in types.items())])


def _parameters(config: type) -> Iterator[str]:
    for info in parameter_infos(config):
        facts = [info.ros_type, f"default {_value(info)}", info.range_text, "" if info.run_time else "fixed at start"]
        yield f"  {info.name}: {'; '.join(filter(None, facts))}"
        yield textwrap.fill(info.doc, _WIDTH, initial_indent="      ", subsequent_indent="      ")


def _value(info: ParameterInfo) -> str:
    """The default in YAML, which JSON is."""
    return json.dumps(info.default)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter values from `name:=value` texts and ROS parameter files to checked values and a PipelineConfig."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from stereo_depth_ros.config import (
    CONFIGS,
    ParameterInfo,
    PipelineConfig,
    parameter_infos,
    replace_checked,
    unknown_parameter,
)
from stereo_depth_ros.config.matchers import MATCHERS, matcher_number
from stereo_depth_ros.config.other_parameters import is_ros_parameter, is_without_effect
from stereo_depth_ros.config.ros_yaml import node_parameters, parse_value
from stereo_depth_ros.core.errors import ConfigError

__all__ = [
    "PIPELINE_NODES",
    "Value",
    "check_texts",
    "parse_assignments",
    "pipeline_config",
    "read_params_file",
    "stage_config",
]

Value: TypeAlias = bool | int | float | str
ConfigT = TypeVar("ConfigT")

# The nodes whose work the pipeline does: processing offline, and the fused node of a replay, take their sections
PIPELINE_NODES = ("rectify_node", "disparity_node", "point_cloud_node", "depth_node", "stereo_depth_node")


def parse_assignments(assignments: Iterable[str], matcher: str | None = None) -> dict[str, Value]:
    """Checked values of ``name:=value`` texts, and of a matcher by name.

    Raises:
        ConfigError: not of this form, an unknown name or an invalid value.
    """
    values: dict[str, Any] = {}
    if matcher is not None:
        if matcher not in MATCHERS:
            raise ConfigError(
                f"matcher {matcher!r} is not one of {', '.join(MATCHERS)}",
                value=matcher,
                limit=tuple(MATCHERS),
                remedy="use one of them",
                settings=("matcher",),
            )
        values["stereo_algorithm"] = matcher_number(matcher)
    for text in assignments:
        name, separator, value = text.partition(":=")
        if not separator:
            raise ConfigError(
                f"parameter {text!r} is not of the form name:=value",
                value=text,
                limit="name:=value",
                remedy="for example disparity_range:=128",
            )
        values[name] = parse_value(name, value)
    infos = _infos()
    return {name: _info(name, infos).check(value) for name, value in values.items()}


def check_texts(texts: Mapping[str, str]) -> dict[str, Value]:
    """Checked values of parameters that are given as text, such as arguments of a launch file.

    Raises:
        ConfigError: an unknown name or an invalid value.
    """
    infos = {name: _info(name, _infos()) for name in texts}
    return {
        name: info.check(texts[name] if info.type is str else parse_value(name, texts[name]))
        for name, info in infos.items()
    }


def read_params_file(path: Path, nodes: Sequence[str] = PIPELINE_NODES) -> dict[str, Value]:
    """Checked values that nodes of the root namespace take from a ROS parameter file, see :func:`node_parameters`.

    Parameters of ROS, and those of stereo_image_proc that have no effect here, are left out.

    Raises:
        ConfigError: the file cannot be read, is not a parameter file, or has an unknown name or an invalid value.
    """
    infos = _infos()
    return {
        name: _checked(name, value, infos, path)
        for name, value in node_parameters(path, *nodes).items()
        if not is_ros_parameter(name) and not is_without_effect(name)
    }


def pipeline_config(values: Mapping[str, Value]) -> PipelineConfig:
    """The configs of all stages with these values.

    Raises:
        ConfigError: values that contradict each other.
    """
    stages: dict[str, Any] = {
        item.name: stage_config(CONFIGS[item.name], values) for item in dataclasses.fields(PipelineConfig)
    }
    return PipelineConfig(**stages)


def stage_config(stage: type[ConfigT], values: Mapping[str, Value]) -> ConfigT:
    """The config of a stage with those of the values that are its parameters.

    Raises:
        ConfigError: values that contradict each other.
    """
    names = {info.name for info in parameter_infos(stage)}
    return replace_checked(stage(), {name: value for name, value in values.items() if name in names})


def _infos() -> dict[str, ParameterInfo]:
    return {info.name: info for stage in CONFIGS.values() for info in parameter_infos(stage)}


def _checked(name: str, value: Any, infos: Mapping[str, ParameterInfo], path: Path) -> Value:
    try:
        return _info(name, infos).check(value)
    except ConfigError as error:
        raise error.about(path) from error


def _info(name: str, infos: Mapping[str, ParameterInfo]) -> ParameterInfo:
    if name not in infos:
        raise unknown_parameter(name, infos)
    return infos[name]

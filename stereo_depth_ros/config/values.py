# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter values from `name:=value` texts and ROS parameter files to checked values and a PipelineConfig."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from stereo_depth_ros.config import (
    CONFIGS,
    ParameterInfo,
    PipelineConfig,
    parameter_infos,
    replace_checked,
    unknown_parameter,
)
from stereo_depth_ros.config.matchers import MATCHERS, matcher_number
from stereo_depth_ros.core.errors import ConfigError

__all__ = ["Value", "parse_assignments", "pipeline_config", "read_params_file"]

Value: TypeAlias = bool | int | float | str

_OTHERS = ("use_sim_time", "qos_overrides")  # of the nodes, not of the pipeline


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
        try:
            values[name] = _load(value)
        except YAMLError as error:
            raise ConfigError(
                f"{value!r} is not a value ({error})",
                subject=f"parameter {name}",
                value=value,
                limit="number, word or bool",
                remedy="write a number, word or bool",
                settings=(name,),
            ) from error
    infos = _infos()
    return {name: _info(name, infos).check(value) for name, value in values.items()}


def read_params_file(path: Path) -> dict[str, Value]:
    """Checked values of all nodes of a ROS parameter file.

    Raises:
        ConfigError: the file cannot be read, is not a parameter file, or has an unknown name or an invalid value.
    """
    try:
        content = _load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, YAMLError) as error:
        raise ConfigError(
            f"is not a parameter file ({error})", subject=str(path), remedy="name a YAML file of ROS parameters"
        ) from error
    sections = [*content.values()] if isinstance(content, Mapping) else [None]
    infos = _infos()
    values: dict[str, Value] = {}
    for section in sections:
        if not isinstance(section, Mapping) or not isinstance(section.get("ros__parameters"), Mapping):
            raise ConfigError(
                "is not a parameter file",
                subject=str(path),
                remedy="write node names (or /**), then ros__parameters below them",
            )
        for name, value in section["ros__parameters"].items():
            if not str(name).startswith(_OTHERS):
                values[name] = _checked(str(name), value, infos, path)
    return values


def pipeline_config(values: Mapping[str, Value]) -> PipelineConfig:
    """The configs of all stages with these values.

    Raises:
        ConfigError: values that contradict each other.
    """
    stages: dict[str, Any] = {}
    for item in dataclasses.fields(PipelineConfig):
        stage = CONFIGS[item.name]
        names = {info.name for info in parameter_infos(stage)}
        given = {name: value for name, value in values.items() if name in names}
        stages[item.name] = replace_checked(stage(), given)
    return PipelineConfig(**stages)


def _load(text: str) -> Any:
    """The value of a YAML text by the rules of YAML 1.1, as in ROS: yes and on are true."""
    yaml = YAML(typ="safe", pure=True)
    yaml.version = (1, 1)
    return yaml.load(text)


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

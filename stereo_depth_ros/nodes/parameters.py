# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Configs as ROS parameters: declared from their metadata, checked, and changed at run time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from stereo_depth_ros.config import CONFIGS, ParameterInfo, parameter_infos, replace_checked, unknown_parameter
from stereo_depth_ros.config.other_parameters import (
    QOS_OVERRIDES,
    is_ros_parameter,
    is_without_effect,
    without_effect_text,
)
from stereo_depth_ros.core.errors import ConfigError, StereoDepthError
from stereo_depth_ros.nodes.log import log_info

__all__ = ["NodeParameters", "error_text", "parameters_of_ros"]

ConfigT = TypeVar("ConfigT")

# Parameters by the names that errors use: the parameter, or the field of its config.
_PARAMETERS: Mapping[str, str] = {
    **{
        key: info.name
        for config in CONFIGS.values()
        for info in parameter_infos(config)
        for key in (info.field, info.name)
    },
    # names of the library
    "matcher": "stereo_algorithm",
    "model": "lens_model",
    **{name: f"board_{name}" for name in ("size", "square", "marker", "dictionary", "spacing")},
}
_QOS_POLICIES = {"reliability": ReliabilityPolicy, "durability": DurabilityPolicy, "history": HistoryPolicy}


class NodeParameters:
    """The configs of a node; parameters of stereo_image_proc that have no effect are named in one line of the log.

    Args:
        node: declares the parameters.
        configs: config classes of the stages this node runs.

    Raises:
        ConfigError: a value given at start has a wrong type or range, no stage has a parameter of that name, or a QoS
            override is not a policy.
    """

    def __init__(self, node: Node, *configs: type) -> None:
        overrides = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
        _refuse_unknown(overrides)
        _refuse_unknown_qos(overrides)
        if text := without_effect_text(overrides):
            log_info(node.get_logger(), text)
        self.on_change: Callable[[], None] = lambda: None
        self._configs: dict[type, Any] = {}
        self._checks: dict[type, Callable[[Any], object]] = {}
        for config in configs:
            given = {i.name: overrides[i.name] for i in parameter_infos(config) if i.name in overrides}
            checked = self._configs[config] = replace_checked(config(), given)
            for info in parameter_infos(config):
                # The checked value: rclpy would refuse an override of 20 for a parameter of 20.0.
                node.declare_parameter(info.name, getattr(checked, info.field), _descriptor(info), ignore_override=True)
        node.add_on_set_parameters_callback(self._on_set)

    def require(self, config: type[ConfigT], check: Callable[[ConfigT], object]) -> None:
        """Calls ``check`` now and before every change of ``config``; it raises ConfigError to refuse a change."""
        check(self.get(config))
        self._checks[config] = check

    def get(self, config: type[ConfigT]) -> ConfigT:
        """The current config; another object after a change."""
        return self._configs[config]  # type: ignore[no-any-return]

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            given = {
                config: {p.name: p.value for p in parameters if p.name in _names(config)} for config in self._configs
            }
            changed = {config: replace_checked(self._configs[config], new) for config, new in given.items() if new}
            changed = {config: value for config, value in changed.items() if value != self._configs[config]}
            for config, value in changed.items():
                self._checks.get(config, lambda _: None)(value)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=error_text(error))
        if changed:
            self._configs |= changed
            self.on_change()
        return SetParametersResult(successful=True)


@contextmanager
def parameters_of_ros() -> Iterator[None]:
    """Around the making of a node, which declares parameters of rclpy; ConfigError where it refuses their values."""
    try:
        yield
    except ParameterException as error:
        raise ConfigError(str(error), remedy="set a value of this type") from error


def error_text(error: StereoDepthError, parameters: Mapping[str, str] = _PARAMETERS) -> str:
    """An error as a node reports it, on one line: with the parameters that its remedy is about.

    Args:
        parameters: name of the parameter by name of the setting.
    """
    names = [parameters[setting] for setting in error.settings if setting in parameters]
    text = f"{error} (parameter{'s' * (len(names) > 1)}: {', '.join(names)})" if names else str(error)
    return " ".join(text.split("\n"))


def _names(config: type) -> set[str]:
    return {info.name for info in parameter_infos(config)}


def _refuse_unknown(overrides: dict[str, Any]) -> None:
    """One parameter file serves all nodes: only names that no stage has are refused, nor a node that this replaces."""
    known = {name for config in CONFIGS.values() for name in _names(config)}
    for name in overrides:
        if name not in known and not is_ros_parameter(name) and not is_without_effect(name):
            raise unknown_parameter(name, known)


def _refuse_unknown_qos(overrides: dict[str, Any]) -> None:
    """At start: rclpy would check them only when a topic is subscribed, which may be much later."""
    for name, value in overrides.items():
        if not name.startswith(QOS_OVERRIDES):
            continue
        if name.endswith(".depth") and (type(value) is not int or value < 0):
            raise ConfigError(
                f"parameter {name} = {value!r} is not a whole number of messages",
                value=value,
                limit=0,
                remedy="set 0 or more",
                settings=(name,),
            )
        policy = _QOS_POLICIES.get(name.rpartition(".")[2])
        if policy and str(value).lower() not in policy.short_keys():
            keys = policy.short_keys()
            raise ConfigError(
                f"parameter {name} = {value!r} is not one of {', '.join(keys)}",
                value=value,
                limit=tuple(keys),
                remedy="use one of them",
                settings=(name,),
            )


def _descriptor(info: ParameterInfo) -> ParameterDescriptor:
    unit = f" [{info.unit}]" if info.unit else ""
    choices = f" One of {', '.join(info.choices)}." if info.choices else ""
    descriptor = ParameterDescriptor(description=info.doc + unit, read_only=not info.run_time)
    descriptor.additional_constraints = choices.strip()
    if info.low is not None and info.high is not None:
        if info.type is int:
            low, high, step = int(info.low), int(info.high), int(info.step or 1)
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=step)]
        else:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(info.low), to_value=float(info.high), step=float(info.step or 0))
            ]
    return descriptor

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Metadata of a parameter (name, type, default, range, step, unit, description) and the check of a value."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from stereo_depth_ros.config.matchers import MATCHERS, matchers_with
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.in_words import kind_in_words
from stereo_depth_ros.core.quoted import quoted

__all__ = ["Checked", "ParameterInfo", "parameter", "parameter_infos", "replace_checked", "unknown_parameter"]


ConfigT = TypeVar("ConfigT")


@dataclass(frozen=True)
class ParameterInfo:
    """Metadata of one parameter: public name, field, type, default, description, range and unit."""

    name: str
    field: str
    type: type
    default: bool | int | float | str
    doc: str
    low: float | None = None
    high: float | None = None
    step: float | None = None
    unit: str = ""
    choices: tuple[str, ...] = ()
    run_time: bool = True

    @property
    def ros_type(self) -> str:
        """The type by its name in ROS."""
        return {bool: "bool", int: "int", float: "double", str: "string"}[self.type]

    @property
    def range_text(self) -> str:
        """Range, step and unit, or the choices, as text; empty if there are none."""
        if self.choices:
            return ", ".join(self.choices)
        if self.low is None or self.high is None:
            return self.unit
        step = f" in steps of {self.step:g}" if self.step else ""
        return f"{self.low:g} to {self.high:g}{step} {self.unit}".rstrip()

    def check(self, value: Any) -> bool | int | float | str:
        """The value in the type of the parameter.

        Raises:
            ConfigError: another type, not one of the choices, or out of range.
        """
        if value is True and "true" in self.choices:
            value = "true"  # YAML has a boolean where the word is not in quotes
        if self.type is float and type(value) is int:
            value = float(value) if abs(value) <= _LARGEST_WHOLE else math.inf
        if type(value) is not self.type:
            raise self._error(
                value,
                f"is {kind_in_words(type(value))}, not {kind_in_words(self.type)}",
                kind_in_words(self.type),
                f"write {kind_in_words(self.type)}, for example {_written(self.default)}",
            )
        if self.choices and value not in self.choices:
            raise self._error(value, f"is not one of {', '.join(self.choices)}", self.choices, "use one of them")
        if isinstance(value, (str, bool)):
            return value
        assert isinstance(value, (int, float))
        if self.low is not None and self.high is not None and not self.low <= value <= self.high:
            limit = (self.low, self.high)
            raise self._error(value, f"is outside {self.low:g}..{self.high:g}", limit, "set it inside that range")
        if isinstance(value, float) and not math.isfinite(value):
            raise self._error(value, "is not finite", "a finite number", "set a number")
        if self.step and self.low is not None and (value - self.low) % self.step:
            below = value - (value - self.low) % self.step
            raise self._error(
                value,
                f"is not {self.low:g} plus a multiple of {self.step:g}",
                self.step,
                f"use {below:g} or {below + self.step:g}",
            )
        return value

    def _error(self, value: Any, problem: str, limit: object, remedy: str) -> ConfigError:
        return ConfigError(
            f"parameter {self.name} = {_written(value)} {problem}", value=value, limit=limit, remedy=remedy
        )


def _written(value: Any) -> str:
    """The value as it is written in YAML."""
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    return quoted(value)


_LARGEST_WHOLE = 2**53  # that a float holds exactly


def parameter(default: bool | int | float | str, doc: str, **info: Any) -> Any:
    """A dataclass field with the metadata of :class:`ParameterInfo`."""
    return field(default=default, metadata={"doc": doc, **info})


def parameter_infos(config: type | object) -> tuple[ParameterInfo, ...]:
    """Metadata of all parameters of a config class, in the order of its fields."""
    return _infos(config if isinstance(config, type) else type(config))


@functools.cache
def _infos(config: type) -> tuple[ParameterInfo, ...]:
    return tuple(_info(item) for item in dataclasses.fields(config))


def _info(item: dataclasses.Field[Any]) -> ParameterInfo:
    info = dict(item.metadata)
    name = info.pop("name", item.name)
    matchers = matchers_with(name)
    if matchers and len(matchers) < len(MATCHERS):
        info["doc"] = f"{info['doc']} For {_listed(matchers)}."
    default: Any = item.default
    return ParameterInfo(name=name, field=item.name, type=type(default), default=default, **info)


def _listed(matchers: tuple[str, ...]) -> str:
    """The matchers, or the missing ones if those are fewer."""
    others = [name for name in MATCHERS if name not in matchers]
    return f"all but {', '.join(others)}" if len(others) < len(matchers) else ", ".join(matchers)


def unknown_parameter(name: str, known: Iterable[str]) -> ConfigError:
    """The error for a name that is not a parameter, with the closest known name if there is one."""
    names = tuple(known)
    close = difflib.get_close_matches(name, names, 1)
    remedy = f"did you mean {close[0]!r}?" if close else "see the table of parameters"
    return ConfigError(f"unknown parameter {quoted(name)}", value=name, limit=names, remedy=remedy)


class Checked:
    """Base of the configs: checks every field against its metadata."""

    def __post_init__(self) -> None:
        for info in parameter_infos(self):
            object.__setattr__(self, info.field, info.check(getattr(self, info.field)))


def replace_checked(config: ConfigT, changes: Mapping[str, Any]) -> ConfigT:
    """A copy of ``config`` with the values of ``changes``, keyed by public name or field name.

    Raises:
        ConfigError: unknown key or invalid value.
    """
    fields = {key: info.field for info in parameter_infos(config) for key in (info.name, info.field)}
    for key in changes:
        if key not in fields:
            raise unknown_parameter(key, fields)
    return dataclasses.replace(config, **{fields[key]: value for key, value in changes.items()})  # type: ignore[type-var]

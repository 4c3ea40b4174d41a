# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is known of a parameter: name, type, default, range, step, unit and one sentence; and the check of a value."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from stereo_depth_ros.config.matchers import MATCHERS, matchers_with
from stereo_depth_ros.core.errors import ConfigError

__all__ = ["Checked", "ParameterInfo", "parameter", "parameter_infos", "replace_checked", "unknown_parameter"]


ConfigT = TypeVar("ConfigT")


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of one parameter: its outside name, field, type, default, range, unit and sentence."""

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
    def range_text(self) -> str:
        """Range, step and unit, or the choices, in words; empty where there is none."""
        if self.choices:
            return ", ".join(self.choices)
        if self.low is None or self.high is None:
            return self.unit
        step = f" in steps of {self.step:g}" if self.step else ""
        return f"{self.low:g} to {self.high:g}{step} {self.unit}".rstrip()

    def check(self, value: Any) -> bool | int | float | str:
        """The value in the parameter's type; ConfigError with value, limit and remedy where it cannot be."""
        if self.type is float and type(value) is int:
            value = float(value)
        if type(value) is not self.type:
            raise ConfigError(
                f"parameter {self.name} = {value!r} is {type(value).__name__}, it takes {self.type.__name__}: "
                f"write it as {self.type.__name__}, for example {self.default!r}"
            )
        if self.choices and value not in self.choices:
            raise ConfigError(
                f"parameter {self.name} = {value!r} is none of {', '.join(self.choices)}: take one of them"
            )
        if isinstance(value, (str, bool)):
            return value
        assert isinstance(value, (int, float))
        if self.low is not None and self.high is not None and not self.low <= value <= self.high:
            raise ConfigError(
                f"parameter {self.name} = {value} is outside {self.low:g}..{self.high:g}: set it inside that range"
            )
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"parameter {self.name} = {value} is not finite: set a number")
        if self.step and self.low is not None and (value - self.low) % self.step:
            below = value - (value - self.low) % self.step
            raise ConfigError(
                f"parameter {self.name} = {value} is not {self.low:g} plus a multiple of {self.step:g}: "
                f"take {below:g} or {below + self.step:g}"
            )
        return value


def parameter(default: bool | int | float | str, doc: str, **info: Any) -> Any:
    return field(default=default, metadata={"doc": doc, **info})


def parameter_infos(config: type | object) -> Iterator[ParameterInfo]:
    """All parameters of a config class, in the order of its fields."""
    for item in dataclasses.fields(config):  # type: ignore[arg-type]
        info = dict(item.metadata)
        name = info.pop("name", item.name)
        matchers = matchers_with(name)
        if matchers and len(matchers) < len(MATCHERS):
            info["doc"] = f"{info['doc'].removesuffix('.')}; {_listed(matchers)}."
        yield ParameterInfo(
            name=name,
            field=item.name,
            type=type(item.default),
            default=item.default,  # type: ignore[arg-type]
            **info,
        )


def _listed(matchers: tuple[str, ...]) -> str:
    """The matchers, or where they are most of them, those that are missing."""
    others = [name for name in MATCHERS if name not in matchers]
    return f"all but {', '.join(others)}" if len(others) < len(matchers) else ", ".join(matchers)


def unknown_parameter(name: str, known: Iterable[str]) -> ConfigError:
    """The error to raise for a name that no parameter has; it names the one that was probably meant."""
    close = difflib.get_close_matches(name, known, 1)
    remedy = f"did you mean {close[0]!r}?" if close else "`stereo-depth parameters` lists all"
    return ConfigError(f"unknown parameter {name!r}: {remedy}")


class Checked:
    """Checks every field against its metadata when the object is made."""

    def __post_init__(self) -> None:
        for info in parameter_infos(self):
            object.__setattr__(self, info.field, info.check(getattr(self, info.field)))


def replace_checked(config: ConfigT, changes: Mapping[str, Any]) -> ConfigT:
    """A copy of ``config`` with the values of ``changes``, keyed by outside name or field name.

    Raises:
        ConfigError: unknown key, or a value that the config refuses.
    """
    fields = {key: info.field for info in parameter_infos(config) for key in (info.name, info.field)}
    for key in changes:
        if key not in fields:
            raise unknown_parameter(key, fields)
    return dataclasses.replace(config, **{fields[key]: value for key, value in changes.items()})  # type: ignore[type-var]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files and values by the rules of ROS: types of values, names of sections, wildcards and their order."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

from stereo_depth_ros.core.errors import ConfigError

__all__ = ["node_parameters", "parse_value"]

_KEY = "ros__parameters"
_TRUE = {"y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"}
_FALSE = {"n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"}
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
_LARGEST_INTEGER = 2**63
_SPECIAL = re.compile(r"[+-]?\.?(inf|nan)", re.IGNORECASE)
_SECTION = re.compile(r"(/(\w+|\*{1,2}))+")


def parse_value(name: str, text: str) -> Any:
    """The value of a parameter that is written as YAML: bool, int, float, str, or a list of these.

    Raises:
        ConfigError: not YAML, nothing, or a mapping.
    """
    problem = f"{text!r} is not a value"
    try:
        root = _yaml().compose(text)
        if isinstance(root, (ScalarNode, SequenceNode)):
            return _value(root)
    except YAMLError as error:
        problem += f" ({error})"
    raise ConfigError(
        problem,
        subject=f"parameter {name}",
        value=text,
        limit="number, word or bool",
        remedy="write a number, word or bool",
        settings=(name,),
    )


def node_parameters(path: Path, *nodes: str) -> dict[str, Any]:
    """The parameters that nodes, with their namespaces, take from a file, by full name.

    Sections apply by their names, which may be nested or contain slashes: ``*`` stands for one part of a name, ``**``
    for any number of parts. Of several sections that set a parameter, the last in the file counts; a repeated section
    counts where it stands first.

    Raises:
        ConfigError: the file cannot be read or is not a parameter file.
    """
    try:
        roots = list(_yaml().compose_all(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, YAMLError) as error:
        raise ConfigError(
            f"is not a parameter file ({error})", subject=str(path), remedy="name a YAML file of ROS parameters"
        ) from error
    if not roots:
        raise _not_a_parameter_file(path)
    sections: dict[str, dict[str, Any]] = {}
    for root in roots:
        for name, parameters in _sections(root, "", path):
            sections.setdefault(name, {}).update(parameters)
    names = [f"/{node}" for node in nodes]
    found: dict[str, Any] = {}
    for section, parameters in sections.items():
        pattern = section.replace("/*", r"(/\w+)")  # which makes (/\w+)* of /**
        if any(re.fullmatch(pattern, name) for name in names):
            found |= parameters
    return found


def _yaml() -> YAML:
    yaml = YAML(typ="safe", pure=True)
    yaml.version = (1, 1)
    return yaml


def _not_a_parameter_file(path: Path) -> ConfigError:
    return ConfigError(
        "is not a parameter file",
        subject=str(path),
        remedy="write node names (or /**), then ros__parameters below them",
    )


def _sections(node: Any, prefix: str, path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Absolute name and parameters of each section."""
    if not isinstance(node, MappingNode):
        raise _not_a_parameter_file(path)
    for key, content in node.value:
        if key.value != _KEY:
            name = key.value if not prefix and key.value.startswith("/") else f"{prefix}/{key.value}"
            yield from _sections(content, name, path)
            continue
        if not isinstance(content, MappingNode):
            raise _not_a_parameter_file(path)
        if not _SECTION.fullmatch(prefix):
            raise ConfigError(
                f"section {prefix!r} is not the name of a node",
                subject=str(path),
                value=prefix,
                limit="words, * and ** separated by single slashes",
                remedy="correct the name",
            )
        yield prefix, dict(_parameters(content, "", path))


def _parameters(mapping: MappingNode, prefix: str, path: Path) -> Iterator[tuple[str, Any]]:
    """Full name and value of each parameter; nested names are joined by dots."""
    for key, content in mapping.value:
        name = f"{prefix}{key.value}"
        if isinstance(content, MappingNode):
            yield from _parameters(content, f"{name}.", path)
        elif isinstance(content, ScalarNode) and not content.value and content.style is None:
            raise ConfigError(
                f"parameter {name} has no value",
                subject=str(path),
                limit="a value",
                remedy="write a value, or '' for none",
            )
        else:
            yield name, _value(content)


def _value(node: Any) -> Any:
    if isinstance(node, SequenceNode):
        return [_value(item) for item in node.value]
    return _scalar(node.value, plain=node.style is None)


def _scalar(text: str, plain: bool) -> bool | int | float | str:
    """The value of a scalar; what is quoted, or neither a bool nor a number, is a text."""
    if not plain:
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _INTEGER.fullmatch(text):
        octal = text.lstrip("+-").startswith("0") and text.lstrip("+-").isdigit()
        number = int(text, 8 if octal else 0)
        return number if -_LARGEST_INTEGER <= number < _LARGEST_INTEGER else float(number)
    if _SPECIAL.fullmatch(text):
        return float(text.replace(".", ""))
    try:
        value = float(text)
    except ValueError:
        return text
    return text if "_" in text or math.isinf(value) else value

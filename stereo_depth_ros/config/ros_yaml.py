# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files and values by the rules of ROS: types of values, names of sections, wildcards and their order."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.safe_yaml import Mapping, Scalar, YamlError, YamlNode, parse_yaml
from stereo_depth_ros.core.text_files import read_text

__all__ = ["node_parameters", "parse_value"]

_KEY = "ros__parameters"
_TRUE = {"y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"}
_FALSE = {"n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"}
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
_LARGEST_INTEGER = 2**63
_LONGEST_NUMBER = 200  # characters
_SPECIAL = re.compile(r"[+-]?\.?(inf|nan)", re.IGNORECASE)
_SECTION = re.compile(r"(/(\w+|\*{1,2}))+")


def parse_value(name: str, text: str) -> Any:
    """The value of a parameter that is written as YAML: bool, int, float, str, or a list of these.

    Raises:
        ConfigError: not YAML, nothing, or a mapping.
    """
    problem = f"{quoted(text)} is not a value"
    try:
        roots = parse_yaml(text)
        if len(roots) == 1 and not isinstance(roots[0], Mapping):
            return _value(roots[0])
    except YamlError as error:
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
    remedy = "name a YAML file of ROS parameters"
    sections: dict[str, dict[str, Any]] = {}
    try:
        roots = parse_yaml(read_text(path, ConfigError, remedy))
        for name, parameters in chain.from_iterable(_sections(root, "", path) for root in roots):
            sections.setdefault(name, {}).update(parameters)
    except YamlError as error:
        raise ConfigError(f"is not a parameter file ({error})", subject=str(path), remedy=remedy) from error
    if not roots:
        raise _not_a_parameter_file(path)
    names = [f"/{node}" for node in nodes]
    found: dict[str, Any] = {}
    for section, parameters in sections.items():
        pattern = section.replace("/*", r"(/\w+)")  # which makes (/\w+)* of /**
        if any(re.fullmatch(pattern, name) for name in names):
            found |= parameters
    return found


def _not_a_parameter_file(path: Path) -> ConfigError:
    return ConfigError(
        "is not a parameter file",
        subject=str(path),
        remedy="write node names (or /**), then ros__parameters below them",
    )


def _sections(node: YamlNode, prefix: str, path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Absolute name and parameters of each section."""
    if not isinstance(node, Mapping):
        raise _not_a_parameter_file(path)
    for key, content in node.items:
        if key != _KEY:
            name = key if not prefix and key.startswith("/") else f"{prefix}/{key}"
            yield from _sections(content, name, path)
            continue
        if not isinstance(content, Mapping):
            raise _not_a_parameter_file(path)
        if not _SECTION.fullmatch(prefix):
            raise ConfigError(
                f"section {quoted(prefix)} is not the name of a node",
                subject=str(path),
                value=prefix,
                limit="words, * and ** separated by single slashes",
                remedy="correct the name",
            )
        yield prefix, dict(_parameters(content, "", path))


def _parameters(mapping: Mapping, prefix: str, path: Path) -> Iterator[tuple[str, Any]]:
    """Full name and value of each parameter; nested names are joined by dots."""
    for key, content in mapping.items:
        name = f"{prefix}{key}"
        if isinstance(content, Mapping):
            yield from _parameters(content, f"{name}.", path)
        elif isinstance(content, Scalar) and not content.text and content.plain:
            raise ConfigError(
                f"parameter {name} has no value",
                subject=str(path),
                limit="a value",
                remedy="write a value, or '' for none",
            )
        else:
            yield name, _value(content)


def _value(node: Any) -> Any:
    if isinstance(node, list):
        return [_value(item) for item in node]
    if isinstance(node, Mapping):
        raise YamlError("a mapping stands in a list")
    return _scalar(node.text, node.plain)


def _scalar(text: str, plain: bool) -> bool | int | float | str:
    """The value of a scalar; what is quoted, or neither a bool nor a number, is a text."""
    if not plain:
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if len(text) > _LONGEST_NUMBER:
        return text
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

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Loads YAML as plain data: stated limits of size, depth and aliases, no tags; all YAML of the package is read here."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from stereo_depth_ros.core.quoted import quoted

if TYPE_CHECKING:
    from ruamel.yaml.events import Event

__all__ = [
    "MAX_DEPTH",
    "MAX_NODES",
    "MAX_TEXT",
    "Mapping",
    "Scalar",
    "YamlError",
    "YamlNode",
    "load_yaml",
    "parse_yaml",
]

MAX_TEXT = 2**20  # characters; 10 s at most
MAX_NODES = 50_000  # with those that aliases repeat
MAX_DEPTH = 32

_NULL = {"", "~", "null", "Null", "NULL"}
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
_BASED = re.compile(r"0[xo][0-9a-fA-F]{1,15}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = re.compile(r"[-+]?\.inf|\.nan", re.IGNORECASE)


class YamlError(ValueError):
    """Text that is not YAML, or is above a limit; one line."""


@dataclass(frozen=True)
class Scalar:
    """A scalar as it is written.

    Attributes:
        text: without quotes.
        plain: whether it stands without quotes and without a tag, so that it may be a number.
    """

    text: str
    plain: bool


@dataclass(frozen=True)
class Mapping:
    """Keys and values in their order; keys may be repeated."""

    items: list[tuple[str, YamlNode]] = field(default_factory=list)


YamlNode: TypeAlias = "Scalar | Mapping | list[Any]"


def load_yaml(text: str) -> Any:
    """The plain data of one document: dict with str keys, list, str, int, float, bool or None.

    Scalars are resolved by the rules of YAML 1.2; an integer of more than 18 digits becomes a float. Tags such as
    ``!!opencv-matrix`` are ignored, directives such as the ``%YAML:1.0`` of OpenCV too.

    Raises:
        YamlError: not YAML, not one document, a key twice, or above a limit: MAX_TEXT, MAX_NODES, MAX_DEPTH.
    """
    documents = parse_yaml(text)
    if len(documents) > 1:
        raise YamlError(f"{len(documents)} documents, not one")
    return _plain(documents[0]) if documents else None


def parse_yaml(text: str) -> list[YamlNode]:
    """The nodes of all documents, scalars as they are written.

    Raises:
        YamlError: not YAML, or above a limit.
    """
    if len(text) > MAX_TEXT:
        raise YamlError(f"more than {MAX_TEXT} characters")
    from ruamel.yaml import YAML  # on first use: most nodes read no YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    documents = _Documents()
    try:
        for event in YAML(typ="safe", pure=True).parse(_without_directives(text)):
            documents.take(event)
    except MarkedYAMLError as error:
        line = f" in line {error.problem_mark.line + 1}" if error.problem_mark is not None else ""
        raise YamlError(_one_line(f"{error.problem or error.context}{line}")) from error
    except YAMLError as error:
        raise YamlError(_one_line(error)) from error
    except YamlError:
        raise
    except (
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as error:  # of the parser
        raise YamlError(_one_line(error)) from error
    return documents.roots


@dataclass
class _Open:
    """A list or mapping that is not complete; ``key`` is one whose value comes next."""

    node: Mapping | list[Any]
    anchor: str | None
    begun: int
    key: str | None = None


class _Documents:
    """Builds nodes from the events of a parser, without recursion, and counts them as if aliases were copies."""

    def __init__(self) -> None:
        self.roots: list[YamlNode] = []
        self._open: list[_Open] = []
        self._anchors: dict[str, tuple[YamlNode, int]] = {}
        self._nodes = 0

    def take(self, event: Event) -> None:
        from ruamel.yaml import events

        if isinstance(event, events.AliasEvent):
            if event.anchor not in self._anchors:
                raise YamlError(f"alias *{event.anchor} stands before its anchor is complete")
            node, size = self._anchors[event.anchor]
            self._count(size)
            self._add(node)
        elif isinstance(event, events.ScalarEvent):
            self._count(1)
            scalar = Scalar(str(event.value), event.style is None and event.tag is None)
            self._remember(event.anchor, scalar, 1)
            self._add(scalar)
        elif isinstance(event, (events.SequenceStartEvent, events.MappingStartEvent)):
            if len(self._open) == MAX_DEPTH:
                raise YamlError(f"more than {MAX_DEPTH} levels deep")
            node = Mapping() if isinstance(event, events.MappingStartEvent) else []
            self._open.append(_Open(node, event.anchor, self._nodes))
            self._count(1)
        elif isinstance(event, (events.SequenceEndEvent, events.MappingEndEvent)):
            ended = self._open.pop()
            self._remember(ended.anchor, ended.node, self._nodes - ended.begun)
            self._add(ended.node)
        elif isinstance(event, events.DocumentStartEvent):
            self._anchors.clear()

    def _count(self, nodes: int) -> None:
        self._nodes += nodes
        if self._nodes > MAX_NODES:
            raise YamlError(f"more than {MAX_NODES} values, those that aliases repeat included")

    def _remember(self, anchor: str | None, node: YamlNode, size: int) -> None:
        if anchor is not None:
            self._anchors[anchor] = node, size

    def _add(self, node: YamlNode) -> None:
        """To the innermost list or mapping."""
        if not self._open:
            self.roots.append(node)
            return
        parent = self._open[-1]
        if isinstance(parent.node, list):
            parent.node.append(node)
        elif parent.key is not None:
            parent.node.items.append((parent.key, node))
            parent.key = None
        elif isinstance(node, Scalar):
            parent.key = node.text
        else:
            raise YamlError("a list or a mapping is used as a key")


def _without_directives(text: str) -> str:
    """The text with the first lines emptied that begin with %: that of OpenCV is not YAML."""
    rows = text.split("\n")
    for at, row in enumerate(rows):
        if row.startswith("%"):
            rows[at] = ""
        elif row.strip() and not row.startswith("#"):
            break
    return "\n".join(rows)


def _plain(node: YamlNode) -> Any:
    if isinstance(node, Scalar):
        return _value(node.text) if node.plain else node.text
    if isinstance(node, list):
        return [_plain(item) for item in node]
    values = {key: _plain(value) for key, value in node.items}
    if len(values) < len(node.items):
        seen: set[str] = set()
        repeated = next(key for key, _ in node.items if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise YamlError(f"the key {quoted(repeated)} stands twice")
    return values


def _value(text: str) -> Any:
    if text in _NULL:
        return None
    if text in _BOOL:
        return _BOOL[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    if _BASED.fullmatch(text):
        return _based(text)
    if _SPECIAL.fullmatch(text):
        return float(text.replace(".", ""))
    return float(text) if _FLOAT.fullmatch(text) else text


def _based(text: str) -> int | str:
    try:
        return int(text, 0)
    except ValueError:
        return text


def _one_line(message: object) -> str:
    return " ".join(str(message).split())

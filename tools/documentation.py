# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes every file, table and drawing that is generated from the code; what `make config` runs."""

from __future__ import annotations

from pathlib import Path

from architecture import render_files, render_tree
from drawing import render_drawing
from parameter_tables import (
    render_launch_table,
    render_matcher_table,
    render_parameter_table,
    render_uniqueness_table,
    render_yaml,
)

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.files.output import write_file

__all__ = ["render_all", "replace_section", "write_all"]


def render_all(root: Path) -> dict[str, str]:
    """The text of every generated file of the source tree ``root``, by its path in the tree.

    Raises:
        ConfigError: a document has no place for a table.
    """
    documents = {
        "README.md": {"matchers": render_matcher_table()},
        "docs/parameters.md": {
            "parameters": render_parameter_table(),
            "uniqueness": render_uniqueness_table(),
            "launch": render_launch_table(root / "launch" / "stereo_depth.launch.py"),
        },
        "docs/ARCHITECTURE.md": {"tree": render_tree(root), "files": render_files(root)},
    }
    return {
        "config/stereo_depth.yaml": render_yaml(),
        **{path: _with_sections(root / path, sections) for path, sections in documents.items()},
        "docs/architecture.svg": render_drawing(root),
    }


def write_all(root: Path) -> None:
    """Writes them.

    Raises:
        ConfigError: see :func:`render_all`; nothing is written then.
    """
    for path, text in render_all(root).items():
        write_file(root / path, text, overwrite=True)


def replace_section(text: str, name: str, body: str) -> str:
    """``text`` with what stands between ``<!-- name:begin -->`` and ``<!-- name:end -->`` replaced by ``body``.

    Raises:
        ConfigError: not exactly one such pair of markers.
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ConfigError(
            f"{text.count(begin)} x {begin} and {text.count(end)} x {end}",
            limit="one of each",
            remedy="the text needs one of each, in this order",
        )
    before, rest = text.split(begin)
    after = rest.split(end)[1]
    return f"{before}{begin}\n{body.strip()}\n{end}{after}"


def _with_sections(path: Path, sections: dict[str, str]) -> str:
    text = path.read_text(encoding="utf-8")
    for name, body in sections.items():
        text = replace_section(text, name, body)
    return text


if __name__ == "__main__":
    write_all(Path(__file__).resolve().parents[1])

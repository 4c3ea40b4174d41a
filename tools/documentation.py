# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes what is generated from the code: the ROS parameter file, and the README's tables of parameters and files."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path

from stereo_depth_ros.config import CONFIGS, ParameterInfo, parameter_infos
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.files.output import write_file

__all__ = ["render_files", "render_table", "render_yaml", "replace_section", "write_files"]

TYPE_NAMES = {bool: "bool", int: "int", float: "double", str: "string"}

YAML_HEAD = """\
# Every parameter at its default. Any node of stereo_depth_ros takes this file and uses the parameters that it has:
#   ros2 run stereo_depth_ros stereo_depth_node --ros-args --params-file stereo_depth.yaml
# Generated from stereo_depth_ros/config/ by `make config`: change it there.
/**:
  ros__parameters:
"""


def render_yaml() -> str:
    """The ROS parameter file: every parameter at its default, what is known of it as a comment, stage by stage."""
    return YAML_HEAD + "\n".join(_yaml_stage(name, stage) for name, stage in _stages())


def render_table() -> str:
    """The Markdown table of all parameters, one row each, in the order of the stages."""
    rows = ["| stage | parameter | type | default | range | meaning |", "| --- | --- | --- | --- | --- | --- |"]
    for name, stage in _stages():
        for info in parameter_infos(stage):
            default = "`" + _yaml_value(info.default) + "`"
            meaning = info.doc if info.run_time else f"{info.doc} Fixed at start."
            cells = (name, f"`{info.name}`", TYPE_NAMES[info.type], default, info.range_text, meaning)
            rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def render_files(root: str | Path) -> str:
    """The Markdown list of all modules below the source tree ``root``: path and the first line of the docstring."""
    lines = []
    for path in sorted((Path(root) / "stereo_depth_ros").rglob("*.py")):
        role = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]
        if role:
            lines.append(f"| `{path.relative_to(root).as_posix()}` | {role} |")
    return "\n".join(["| file | role |", "| --- | --- |", *lines])


def replace_section(text: str, name: str, body: str) -> str:
    """``text`` with what stands between ``<!-- name:begin -->`` and ``<!-- name:end -->`` replaced by ``body``.

    Raises:
        ConfigError: not exactly one such pair of markers.
    """
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ConfigError(
            f"{text.count(begin)} x {begin} and {text.count(end)} x {end}: the text needs one of each, in this order"
        )
    before, rest = text.split(begin)
    after = rest.split(end)[1]
    return f"{before}{begin}\n{body.strip()}\n{end}{after}"


def write_files(root: str | Path) -> None:
    """Writes ``config/stereo_depth.yaml`` and the tables in ``README.md`` of the source tree ``root``.

    Raises:
        ConfigError: the README has no place for the tables.
    """
    write_file(Path(root) / "config" / "stereo_depth.yaml", render_yaml(), overwrite=True)
    readme = Path(root) / "README.md"
    text = replace_section(readme.read_text(encoding="utf-8"), "parameters", render_table())
    text = replace_section(text, "files", render_files(root))
    write_file(readme, text, overwrite=True)


def _stages() -> Iterator[tuple[str, object]]:
    for name, config in CONFIGS.items():
        yield name, config()


def _yaml_stage(name: str, stage: object) -> str:
    what = (stage.__doc__ or "").splitlines()[0]
    lines = [f"    # --- {name}: {what}"]
    for info in parameter_infos(stage):
        lines += [f"    # {info.doc}", *_yaml_facts(info), f"    {info.name}: {_yaml_value(info.default)}"]
    return "\n".join(lines) + "\n"


def _yaml_facts(info: ParameterInfo) -> list[str]:
    facts = [info.range_text] if info.range_text else []
    if not info.run_time:
        facts.append("fixed at start")
    return [f"    # {'; '.join(facts)}"] if facts else []


def _yaml_value(value: bool | int | float | str) -> str:
    """A scalar that YAML reads back with the same type and value: JSON's form is one."""
    return json.dumps(value)


if __name__ == "__main__":
    write_files(Path(__file__).resolve().parents[1])

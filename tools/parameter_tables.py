# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS parameter file and the tables of matchers, parameters and launch arguments of the documentation."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path

from stereo_depth_ros.config import CONFIGS, ParameterInfo, parameter_infos
from stereo_depth_ros.config.matchers import MATCHERS

__all__ = [
    "render_launch_table",
    "render_matcher_table",
    "render_parameter_table",
    "render_uniqueness_table",
    "render_yaml",
]

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


def render_parameter_table() -> str:
    """The Markdown table of all parameters, one row each, in the order of the stages."""
    rows = ["| stage | parameter | type | default | range | meaning |", "| --- | --- | --- | --- | --- | --- |"]
    for name, stage in _stages():
        for info in parameter_infos(stage):
            default = "`" + _yaml_value(info.default) + "`"
            meaning = info.doc if info.run_time else f"{info.doc} Fixed at start."
            rows.append(_row(name, f"`{info.name}`", info.ros_type, default, info.range_text, meaning))
    return "\n".join(rows)


def render_matcher_table() -> str:
    """The Markdown table of all matchers, one row each, in the order of their numbers."""
    rows = ["| number | name | what it does |", "| --- | --- | --- |"]
    rows += [_row(str(number), f"`{info.name}`", info.sentence) for number, info in enumerate(MATCHERS.values())]
    return "\n".join(rows)


def render_uniqueness_table() -> str:
    """The Markdown table of the meaning of ``uniqueness_ratio``, one row for each matcher."""
    rows = ["| matcher | `uniqueness_ratio` |", "| --- | --- |"]
    rows += [_row(f"`{info.name}`", info.uniqueness or "no effect") for info in MATCHERS.values()]
    return "\n".join(rows)


def render_launch_table(launch_file: Path) -> str:
    """The Markdown table of the arguments of the launch file that are not parameters, from its table ``ARGUMENTS``.

    The file is parsed, not imported: ``launch`` is available with ROS 2 only.
    """
    assignments = [node for node in ast.parse(launch_file.read_text("utf-8")).body if isinstance(node, ast.Assign)]
    (arguments,) = (ast.literal_eval(node.value) for node in assignments if ast.unparse(node.targets[0]) == "ARGUMENTS")
    rows = ["| argument | default | meaning |", "| --- | --- | --- |"]
    rows += [_row(f"`{name}`", f"`{default}`" if default else "", text) for name, (default, text) in arguments.items()]
    return "\n".join(rows)


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


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

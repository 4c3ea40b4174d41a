# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth parameters`: lists every parameter with default, range and meaning."""

from __future__ import annotations

import dataclasses
from typing import Any

from stereo_depth_ros.cli.options import Json, Overwrite, new_app
from stereo_depth_ros.cli.output import show
from stereo_depth_ros.cli.tables import TextTable, plain_table
from stereo_depth_ros.config import CONFIGS, ParameterInfo, parameter_infos
from stereo_depth_ros.files.output import check_outputs

__all__ = ["app"]

app = new_app()


@app.command()
def parameters(json_file: Json = None, overwrite: Overwrite = False) -> None:
    """List every parameter with its default, range and meaning.

    \b
    Example:
      stereo-depth parameters
    """
    check_outputs((), reports=[json_file], overwrite=overwrite)
    show([_table()], _values(), json_file, overwrite=overwrite)


def _table() -> TextTable:
    """A row for each parameter, a section for each stage."""
    table = plain_table("parameter", "default:r", "range", "meaning")
    for stage in CONFIGS.values():
        for info in parameter_infos(stage):
            table.add_row(info.name, _default(info), info.range_text, info.doc)
    return table


def _default(info: ParameterInfo) -> str:
    """As it is written in YAML."""
    return str(info.default).lower() if info.type is bool else str(info.default)


def _values() -> list[dict[str, Any]]:
    """The same as JSON values."""
    return [
        dataclasses.asdict(info) | {"type": info.type.__name__}
        for stage in CONFIGS.values()
        for info in parameter_infos(stage)
    ]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The options that several commands have, each spelled once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.config.matchers import MATCHERS

__all__ = [
    "Bag",
    "BagOutput",
    "Duration",
    "Json",
    "Left",
    "Matcher",
    "Overwrite",
    "Params",
    "ParamsFile",
    "Right",
    "Separate",
    "Start",
    "new_app",
]

Bag = Annotated[Path, typer.Argument(metavar="BAG", help="MCAP or .db3 file, or rosbag2 folder.")]
BagOutput = Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="Bag to write.")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - is stdout.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace outputs that exist.")]
Left = Annotated[
    str | None, typer.Option("--left", metavar="TOPIC", help="Left image topic; found where it is not given.")
]
Right = Annotated[
    str | None, typer.Option("--right", metavar="TOPIC", help="Right image topic; found where it is not given.")
]
Start = Annotated[float, typer.Option(min=0, help="Seconds of the bag to skip at the beginning.")]
Duration = Annotated[float, typer.Option(min=0, help="Seconds of the bag to read; 0 is all.")]
Matcher = Annotated[str | None, typer.Option(metavar="NAME", help=f"{', '.join(MATCHERS)}: sets stereo_algorithm.")]
Params = Annotated[
    list[str] | None, typer.Option("--param", "-p", metavar="NAME:=VALUE", help="A parameter; may be repeated.")
]
ParamsFile = Annotated[
    Path | None, typer.Option("--params-file", metavar="FILE", help="ROS parameter file; --param wins over it.")
]
Separate = Annotated[bool, typer.Option("--separate", help="One process per node; fused by default.")]


def new_app(help: str | None = None) -> typer.Typer:
    """A Typer of the style that all commands have: plain help, no tracebacks of its own."""
    return typer.Typer(
        no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False, help=help
    )

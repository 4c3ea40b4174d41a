# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options shared by several commands."""

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
Json = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - prints it instead of tables.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing output files.")]
Left = Annotated[str | None, typer.Option("--left", metavar="TOPIC", help="Left image topic; detected by default.")]
Right = Annotated[str | None, typer.Option("--right", metavar="TOPIC", help="Right image topic; detected by default.")]
Start = Annotated[float, typer.Option(min=0, metavar="SECONDS", help="Time to skip at the beginning of the bag.")]
Duration = Annotated[float, typer.Option(min=0, metavar="SECONDS", help="Time to read; 0: all.")]
Matcher = Annotated[str | None, typer.Option(metavar="NAME", help=f"Matcher: {', '.join(MATCHERS)}.")]
Params = Annotated[
    list[str] | None, typer.Option("--param", "-p", metavar="NAME:=VALUE", help="Set a parameter; may be repeated.")
]
ParamsFile = Annotated[
    Path | None,
    typer.Option("--params-file", metavar="FILE", help="ROS parameter file; --param and --matcher take precedence."),
]
Separate = Annotated[bool, typer.Option("--separate", help="One process per node instead of one for all stages.")]


def new_app(help: str | None = None) -> typer.Typer:
    """A Typer in the style of all commands: plain help, no pretty tracebacks."""
    return typer.Typer(
        no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False, help=help
    )

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth ...`: the commands in one table; each is imported when it is called.

Exit codes: 0 success, 1 an error reported in one line, 2 wrong usage, 3 outputs were lost.
"""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Mapping
from importlib import metadata
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from stereo_depth_ros.cli.errors import error_line
from stereo_depth_ros.cli.stdout import finish_stdout
from stereo_depth_ros.core.errors import StereoDepthError

__all__ = ["COMMANDS", "app", "main"]

# name of the command (and, with _ for -, of its module), first line of its help; in the order of use
COMMANDS: Mapping[str, str] = {
    "info": "List what is in a bag, whether it is usable for stereo depth, and why not.",
    "process": "Compute depth of a bag without a graph: the same outputs as replay, without ROS.",
    "replay": "Play a bag through the live graph, in this ROS_DOMAIN_ID, and record what comes out.",
    "demo": "Play the sample bag through the live graph; prints a table, writes a bag and an image.",
    "doctor": "Examine a stereo setup: calibration, stamps, images, rows; state what is wrong and what to do.",
    "calibrate": "Calibrate both cameras and the rig from pairs of images of a board.",
    "rectify": "Rectify a pair of images.",
    "rig": "Compute what a rig can see: fields of view, range, depth error at each meter, disparity range.",
    "evaluate": "Compare the disparities of methods with the truth, and measure their time.",
    "convert": "Write a dataset as a stereo bag, with camera infos and, where it is known, the truth.",
    "synthesize": "Write a synthetic stereo bag with exact truth: a room seen by a moving, distorted, verged rig.",
    "parameters": "List every parameter with default, range and meaning.",
    "compile-kernels": "Compile the kernels of every method now; otherwise each is compiled at the first start.",
}


class CommandTable(TyperGroup):
    """The group of all commands; the module of a command is imported when the command is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """All names."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name, None where there is none."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"stereo_depth_ros.cli.{cmd_name.replace('-', '_')}")
        command = typer.main.get_command(module.app)
        command.name = cmd_name
        return command

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The table, without an import."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


app = typer.Typer(
    cls=CommandTable,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"stereo_depth_ros {metadata.version('stereo_depth_ros')}")
        raise typer.Exit


@app.callback()
def stereo_depth(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Stereo depth for ROS 2: from bags and live graphs to disparity, depth and point clouds."""


def main() -> None:
    """The console script: one line for a known error."""
    signal.signal(signal.SIGTERM, _interrupt)  # the nodes that were started are stopped, as after Ctrl-C
    try:
        try:
            app()
        finally:
            finish_stdout()
    except (StereoDepthError, OSError) as error:
        print(error_line(error), file=sys.stderr)
        sys.exit(1)


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()

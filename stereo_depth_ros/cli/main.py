# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth ...`: the table of commands; the module of a command is imported when the command is called.

Exit codes: 0 success, 1 an error reported in one line, 2 wrong usage, 3 incomplete results, 130 interrupted.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from stereo_depth_ros.cli.errors import command_options, error_line, given_value
from stereo_depth_ros.cli.interrupts import interrupts_end_the_command
from stereo_depth_ros.cli.shell import require_known_shell
from stereo_depth_ros.cli.stdout import finish_stdout, own_stdout
from stereo_depth_ros.core.errors import ConfigError, StereoDepthError
from stereo_depth_ros.core.printable import printable

__all__ = ["COMMANDS", "app", "main"]

# In the order of use: name of the command, which is also its module (with _ for -), and the first line of its help
COMMANDS: Mapping[str, str] = {
    "demo": "Play the sample bag through the live graph, print the results, and write a bag and an image.",
    "info": "List the contents of a bag and state whether it is usable for stereo depth, and if not, why.",
    "doctor": "Examine the calibration, time stamps and images of a stereo setup, and state faults and remedies.",
    "process": "Compute the depth of a bag without a ROS graph: messages as those of replay, ROS is not needed.",
    "replay": "Play a bag through the live graph in the current ROS_DOMAIN_ID and record the outputs.",
    "calibrate": "Calibrate both cameras and the rig from image pairs of a calibration board.",
    "calibrate-laser": "Calibrate the light plane of a laser from images of its stripe on a board.",
    "calibrate-projector": "Calibrate a projector and its camera from a board under patterns, in several poses.",
    "calibrate-turntable": "Calibrate the axis of a turntable from images of markers or of a board on it.",
    "rectify": "Rectify a pair of images, with or without a calibration.",
    "view": "Draw one kind of view of a bag or a pair of images: an image, an animation or a video.",
    "rig": "Compute the fields of view, depth range, depth errors and recommended disparity range of a rig.",
    "patterns": "Write the patterns that a projector shows for a scan, and their manifest.",
    "scan": "Compute depth from images of projected light: of patterns, or of a light stripe.",
    "focus": "Compute depth and an all-in-focus image from images at several focus distances.",
    "fuse": "Fuse the depth of all pairs of a bag or dataset, with poses of the camera, to one surface.",
    "convert": "Write a dataset as a stereo bag with camera infos and, if the dataset has it, ground truth.",
    "evaluate": "Compare the disparities of matchers with ground truth, and measure their computing time.",
    "synthesize": "Write a synthetic stereo bag with exact ground truth.",
    "parameters": "List every parameter with its default, range and meaning.",
    "compile-kernels": "Compile the kernels of every method in advance; otherwise each is compiled on first use.",
}


class CommandTable(TyperGroup):
    """The group of all commands; imports the module of a command on demand."""

    def __init__(self, **settings: Any) -> None:
        """Commands by name and help only, which are listed, completed and suggested without being imported."""
        super().__init__(**{**settings, "commands": {n: TyperCommand(n, help=text) for n, text in COMMANDS.items()}})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name; None if it does not exist."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"stereo_depth_ros.cli.{cmd_name.replace('-', '_')}")
        command = typer.main.get_command(module.app)
        command.name = cmd_name
        return command

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options of the program."""
        if {"--install-completion", "--show-completion"} & {*args} and not ctx.resilient_parsing:
            require_known_shell()
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; errors about the value of an option name the value."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            error.message += given_value(error)
            raise

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Completions of a command or option, without importing the commands."""
        names = TyperGroup(commands={**self.commands}, params=self.params)
        return names.shell_complete(typer.Context(names), incomplete)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Print the table of commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


app = typer.Typer(
    cls=CommandTable,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
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
    """Compute disparity, depth and point clouds from stereo images, of bags and of live ROS 2 graphs."""


def main() -> None:
    """Run the command of the arguments; reports expected errors in one line."""
    own_stdout()
    try:
        with interrupts_end_the_command():
            try:
                app(prog_name="stereo-depth")
            finally:
                finish_stdout()
    except (StereoDepthError, OSError) as error:
        print(printable(error_line(error, _called_options(sys.argv[1:]))), file=sys.stderr)
        sys.exit(2 if isinstance(error, ConfigError) else 1)


def _called_options(arguments: Sequence[str]) -> set[str]:
    """The options of the command in the arguments."""
    group: Any = typer.main.get_command(app)
    name = next((argument for argument in arguments if argument in COMMANDS), None)
    return command_options(group.get_command(None, name)) if name else set()


if __name__ == "__main__":
    main()

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table of commands: complete, consistent with the help of the commands, and available without importing them."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
import typer

from stereo_depth_ros.cli.errors import command_options, error_line, error_text
from stereo_depth_ros.cli.main import COMMANDS, app
from stereo_depth_ros.core.errors import TopicError

CLI = Path(__file__).resolve().parents[1] / "stereo_depth_ros" / "cli"
HEAVY = ("numpy", "cv2", "numba", "rich", "rosbags", "mcap", "ruamel.yaml", "rclpy")


def start(*arguments: str) -> tuple[int, str, set[str]]:
    """Exit code, output and imported heavy modules of `stereo-depth` with these arguments."""
    program = (
        f"import sys; sys.argv = ['stereo-depth', *{arguments!r}]\n"
        "from stereo_depth_ros.cli.main import main\n"
        "try:\n    main()\nfinally:\n    print(sorted(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout, {name for name in HEAVY if f"'{name}'" in done.stderr}


@pytest.mark.parametrize("argument", ["--help", "-h", "--version"])
def test_help_and_version_import_no_command(argument: str) -> None:
    code, output, imported = start(argument)
    assert (code, imported) == (0, set())
    if argument == "--version":
        assert output == f"stereo_depth_ros {metadata.version('stereo_depth_ros')}\n"
    else:
        assert all(name in output for name in COMMANDS)


def test_start_sees_the_imports_of_a_command() -> None:
    assert {"numpy", "numba"} <= start("process", "--help")[2]


@pytest.mark.parametrize("name", ["info", "doctor", "parameters", "rectify", "calibrate"])
def test_commands_without_kernels_start_without_the_compiler(name: str) -> None:
    """It is a third of their start."""
    assert "numba" not in start(name, "--help")[2]


@pytest.mark.parametrize("name", COMMANDS)
def test_the_line_of_a_command_is_the_first_of_its_help(name: str) -> None:
    group: Any = typer.main.get_command(app)
    command = group.get_command(None, name)
    assert command is not None and command.name == name
    first = command.help.strip().split("\n")[0]
    assert first.rstrip(".").startswith(COMMANDS[name].rstrip(".")) or COMMANDS[name].startswith(first.rstrip("."))


def test_every_module_with_commands_is_in_the_table() -> None:
    modules = {path.stem.replace("_", "-") for path in CLI.glob("*.py") if "@app.command(" in path.read_text("utf-8")}
    assert modules == set(COMMANDS)


def test_an_unknown_command_is_wrong_usage() -> None:
    assert start("replayy")[0] == 2


def test_settings_of_an_error_become_options() -> None:
    error = TopicError("2 pairs are equally good", remedy="name both", settings=("left", "disparity_range"))
    assert error_line(error) == "error: 2 pairs are equally good: name both (--left, --param disparity_range:=...)"
    assert error_line(TopicError("no topic", subject="drive.mcap")) == "error: drive.mcap: no topic"
    assert error_text(error.about("drive.mcap")).startswith("drive.mcap: 2 pairs are equally good: name both (--left")


def test_only_options_of_the_command_are_named() -> None:
    group: Any = typer.main.get_command(app)
    options = {name: command_options(group.get_command(None, name)) for name in ("process", "convert", "calibrate")}
    names = ("overwrite", "start_seconds", "rate_hz", "disparity_range", "board", "queue")
    error = TopicError("problem", settings=names)
    found = {name: error_text(error, options[name]) for name in options}
    assert found["process"] == "problem (--overwrite, --start, --param disparity_range:=...)"
    assert found["convert"] == "problem (--overwrite, --rate)"
    assert found["calibrate"] == "problem (--overwrite, --board)"


def test_an_error_is_one_line_without_an_error_number() -> None:
    assert error_line(TopicError("two\nlines")) == "error: two lines"
    assert error_line(FileNotFoundError(2, "No such file or directory", "a.yaml")) == (
        "error: a.yaml: it does not exist"
    )
    assert error_line(OSError("odd")) == "error: odd"

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The help of all commands is in whole sentences; errors of usage name the value and the nearest command."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from command_line import CommandLine, Run

from stereo_depth_ros.cli.main import COMMANDS, app

# First words of the sentences that say what a command or an option does, and verbs of the other sentences.
IMPERATIVES = (
    *("Calibrate", "Compare", "Compile", "Compute", "Convert", "Evaluate", "Examine", "Install", "Keep", "Limit"),
    *("Draw", "Fuse", "List", "Listen", "Look", "Match", "Play", "Plot", "Print", "Process", "Publish"),
    *("Read", "Rectify", "Render", "Replace", "Run", "Send", "Set", "Show", "Skip"),
    *("Start", "Take", "Use", "Write"),
)
VERBS = (
    *("are", "assume", "can", "cannot", "contains", "counts", "differ", "form", "has"),
    *("have", "is", "must", "need", "receives"),
)
EXAMPLES = re.compile(r"\x08\s*Examples?:.*", re.DOTALL)


def commands(command: Any, name: str = "stereo-depth") -> Iterator[tuple[str, Any]]:
    """The command and all below it, by their names."""
    yield name, command
    if hasattr(command, "list_commands"):
        for each in command.list_commands(None):
            yield from commands(command.get_command(None, each), f"{name} {each}")


ALL = dict(commands(typer.main.get_command(app)))


def sentences(text: str) -> list[str]:
    """The sentences of a help text, without the examples at its end."""
    text = " ".join(EXAMPLES.sub("", text).split())
    return re.split(r"(?<=[.!?])\s+(?=[A-Z\"-])", text)


def faults(text: str) -> list[str]:
    """Sentences without a capital letter, a full stop or a verb."""
    return [
        sentence
        for sentence in sentences(text)
        if not sentence.endswith(".")
        or not (sentence[0].isupper() or sentence[0] in '"-')
        or not (sentence.split()[0] in IMPERATIVES or set(VERBS) & set(re.findall(r"[a-z]+", sentence)))
    ]


@pytest.mark.parametrize("name", ALL)
def test_the_help_of_a_command_is_whole_sentences(name: str) -> None:
    assert faults(ALL[name].help) == []
    assert ALL[name].help.split()[0] in IMPERATIVES or name == "stereo-depth"
    without = [parameter.name for parameter in ALL[name].params if not getattr(parameter, "help", None)]
    assert without == [], "every parameter has a help text"
    texts = {parameter.name: parameter.help for parameter in ALL[name].params}
    assert {key: faults(text) for key, text in texts.items() if faults(text)} == {}
    assert [key for key, text in texts.items() if text.split()[0] not in IMPERATIVES] == []


def test_the_table_of_commands_is_whole_sentences_in_the_order_of_use() -> None:
    assert [text for text in COMMANDS.values() if faults(text)] == []
    order = ["demo", "info", "doctor", "process", "replay", "calibrate"]
    assert [*COMMANDS][: len(order)] == order
    assert [*COMMANDS][-1] == "compile-kernels"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("Bag to write.", True),
        ("write the bag.", True),
        ("Write the bag", True),
        ("Write the bag.", False),
        ("Write the bag. Two lines", True),
        ("Write the bag. Its name is kept.", False),
        ("Write the bag.\n\n\b\nExamples:\n  stereo-depth info", False),
    ],
)
def test_the_rule_finds_it(text: str, fault: bool) -> None:
    assert bool(faults(text)) is fault


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line()


@pytest.mark.parametrize(
    ("arguments", "option", "value"),
    [
        (("replay", "a.mcap", "-o", "x.mcap", "--loop", "0"), "--loop", "0"),
        (("replay", "a.mcap", "-o", "x.mcap", "--in-flight", "101"), "--in-flight", "101"),
        (("process", "a.mcap", "-o", "x.mcap", "--start", "-0.5"), "--start", "-0.5"),
        (("process", "a.mcap", "-o", "x.mcap", "--start", "soon"), "--start", "soon"),
        (("synthesize", "x.mcap", "--width", "15"), "--width", "15"),
        (("convert", "images", "a", "x.mcap", "--rate", "fast"), "--rate", "fast"),
    ],
)
def test_an_error_of_a_value_names_it(run: Run, arguments: tuple[str, ...], option: str, value: str) -> None:
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    last = err.splitlines()[-1]
    assert re.search(rf"Error: Invalid value for '{option}': .*(?<![\d.]){re.escape(value)}(?![\d.]*\d)", last), err


def test_an_unknown_command_or_option_suggests_the_nearest(run: Run) -> None:
    assert "No such command 'proces'. Did you mean 'process'?" in run("proces")[2]
    assert "Did you mean 'kitti'?" in run("convert", "kity")[2]
    assert "--matcher" in run("process", "a", "-o", "b", "--match", "bm")[2]
    code, _, err = run("xyzzy")
    assert code == 2 and "No such command 'xyzzy'." in err

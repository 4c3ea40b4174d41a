# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Text of the command line: names from bags and files as they are, tables in terminals and pipes, progress."""

from __future__ import annotations

import io
import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine
from stereo_bags import write_truth_bag

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.cli import output
from stereo_depth_ros.cli.output import ProgressLines, tell
from stereo_depth_ros.cli.tables import facts_table, plain_table, print_tables

MARKUP = "[bold]a[/bold][red][/]:warning:"
CONTROLS = "\x1b[31m\x1b]0;t\x07\r\b\u202e"
SHOWN = "\\x1b[31m\\x1b]0;t\\x07\\r\\x08\\u202e"


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A usable bag whose names of topics, frames and files hold markup and control characters."""
    folder = tmp_path_factory.mktemp("hostile")
    write_truth_bag(folder / "in.mcap", 2)
    path, types = folder / f"{MARKUP.replace('/', '')}.mcap", RosbagsTypes()
    with BagReader(folder / "in.mcap") as reader, BagWriter(path) as writer:
        for message in reader.messages():
            if message.topic.startswith("/truth"):
                continue
            content: Any = types.deserialize(message.data, message.msgtype)
            frame = f"{content.header.frame_id}{CONTROLS}{MARKUP}"
            content = replace(content, header=replace(content.header, frame_id=frame))
            writer.write(f"/{MARKUP}{CONTROLS}{message.topic}", content, message.log_time_ns)
    return path


def assert_safe(*texts: str) -> None:
    for text in texts:
        assert not [character for character in text if not (character.isprintable() or character == "\n")]


def test_info_of_hostile_names(command_line: CommandLine, hostile: Path) -> None:
    code, out, err = command_line("info")(hostile)
    assert (code, err) == (0, "")
    assert_safe(out)
    assert f"left                     /{MARKUP}{SHOWN}/left/image_raw\n" in out
    values = json.loads(command_line("info")(hostile, "--json", "-")[1])
    assert values["stereo"]["left_image"] == f"/{MARKUP}{CONTROLS}/left/image_raw"
    assert values["path"] == str(hostile)


def test_doctor_of_hostile_names(command_line: CommandLine, hostile: Path) -> None:
    _, out, err = command_line("doctor")(hostile)
    assert_safe(out, err)
    assert f"/{MARKUP}{SHOWN}/left/image_raw" in out
    values = json.loads(command_line("doctor")(hostile, "--json", "-")[1])
    assert values["topics"]["left"]["image"] == f"/{MARKUP}{CONTROLS}/left/image_raw"


def test_process_of_hostile_names(command_line: CommandLine, hostile: Path, tmp_path: Path) -> None:
    made = tmp_path / f"{MARKUP.replace('/', '')}{CONTROLS}.mcap"
    code, out, err = command_line("process")(hostile, "-o", made, "-p", "disparity_range:=32")
    assert code == 0, err
    assert_safe(out, err)
    assert f"{MARKUP.replace('/', '')}{SHOWN}.mcap" in out
    code, out, err = command_line("process")(hostile, "-o", made)
    assert code == 1
    assert_safe(err)
    assert f"{SHOWN}.mcap: already exists" in err


def test_markup_and_emoji_in_messages_are_text(capsys: pytest.CaptureFixture[str]) -> None:
    tell(MARKUP)
    assert capsys.readouterr().err == f"{MARKUP}\n"


def _tables() -> list[Any]:
    table, facts = plain_table("name", "long\ntitle:r", title="above " * 30), facts_table()
    table.add_row("word " * 40, "1")
    facts.add_row("verdict", "word " * 40)
    return [table, facts]


def test_a_record_is_one_line_in_a_pipe(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    print_tables(_tables())
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if line] == ["above", "name", "word", "verdict"]
    assert lines[1].split() == ["name", "long", "title"]
    assert all(line == line.rstrip() for line in lines)


def test_tables_fit_into_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stdout", screen := Terminal())
    print_tables(_tables())
    shown = re.sub(r"\x1b\[[0-9;]*m", "", screen.getvalue())
    assert max(map(len, shown.splitlines())) <= 40
    assert shown.split().count("word") == 80


def test_progress_without_a_terminal_is_a_line_each_ten_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    calls = ((1.0, 0), (9.0, 0), (12.0, 0), (40.0, 1), (45.0, 6), (51.0, 12), (59.0, 20), (61.0, 22))
    clock = iter([0.0, *(now for now, _ in calls)])
    progress = ProgressLines("computing", lambda: next(clock))
    for _, done in calls:
        progress(done, 122)
    # the first pair came after 40 s of compilation; since then one each second
    assert capsys.readouterr().err.splitlines() == [
        "computing: 0 of 122",
        "computing: 1 of 122",
        "computing: 12 of 122, about 110 s left",
        "computing: 22 of 122, about 100 s left",
    ]


def test_commands_show_progress_without_a_terminal(
    command_line: CommandLine, hostile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output, "_EVERY_S", 0.0)
    assert "reading: " in command_line("doctor")(hostile)[2]
    small = ("--frames", "2", "--width", "32", "--height", "24", "--overwrite")
    assert "rendering: 2 of 2\n" in command_line("synthesize")(hostile.with_name("small.mcap"), *small)[2]

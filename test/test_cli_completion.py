# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shell completion: commands, their options, choices and files, by the protocol of the shells, in this process."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pytest
import shellingham
from command_line import CommandLine, Run

from stereo_depth_ros.calibration.projection import MODELS
from stereo_depth_ros.cli.main import COMMANDS
from stereo_depth_ros.config.matchers import MATCHERS

# the words of a line, of which the last one is incomplete, to its completions
Complete: TypeAlias = Callable[..., list[str]]


@pytest.fixture
def run(command_line: CommandLine) -> Run:
    return command_line()


@pytest.fixture
def bash(run: Run, monkeypatch: pytest.MonkeyPatch) -> Complete:
    def complete(*words: str) -> list[str]:
        monkeypatch.setenv("_STEREO_DEPTH_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", "\n".join(("stereo-depth", *words)))
        monkeypatch.setenv("COMP_CWORD", str(len(words)))
        code, out, err = run()
        assert (code, err) == (0, "")
        return out.split()

    return complete


def test_commands(bash: Complete) -> None:
    assert bash("") == list(COMMANDS)
    assert bash("pr") == ["process"]
    assert bash("convert", "k") == ["kitti"]


def test_completing_a_command_imports_none(bash: Complete, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in COMMANDS:
        monkeypatch.delitem(sys.modules, f"stereo_depth_ros.cli.{name.replace('-', '_')}", raising=False)
    assert "rectify" in bash("r")
    assert "stereo_depth_ros.cli.rectify" not in sys.modules


def test_options_of_the_program_and_of_a_command(bash: Complete) -> None:
    assert {"--version", "--help", "--install-completion", "--show-completion"} <= set(bash("--"))
    assert bash("process", "--par") == ["--param", "--params-file"]
    assert {"--matcher", "--start", "--overwrite", "-o", "-h"} <= set(bash("process", "-"))
    assert "--loop" not in bash("process", "in.mcap", "-")
    assert bash("convert", "images", "--c") == ["--camera-info"]


@pytest.mark.parametrize(
    ("command", "option", "choices"),
    [
        *((name, "--matcher", [*MATCHERS]) for name in ("process", "replay", "demo", "rig", "evaluate")),
        ("calibrate", "--board", ["chessboard", "charuco", "aprilgrid"]),
        ("calibrate", "--model", [*MODELS]),
        ("rectify", "--method", ["textbook"]),
    ],
)
def test_choices(bash: Complete, command: str, option: str, choices: list[str]) -> None:
    assert set(choices) <= set(bash(command, option, ""))
    assert all(choice in bash(command, option, choice[:3]) for choice in choices)
    assert bash(command, option, "nothing") == []


@pytest.mark.parametrize(
    "words", [("info", ""), ("info", "dri"), ("process", "a.mcap", "-o", "out/"), ("rig", "a", "")]
)
def test_files_are_left_to_the_shell(bash: Complete, words: tuple[str, ...]) -> None:
    assert bash(*words) == []


def test_zsh_gets_the_help_beside_the_names(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_STEREO_DEPTH_COMPLETE", "complete_zsh")
    monkeypatch.setenv("_TYPER_COMPLETE_ARGS", "stereo-depth process --over")
    assert run()[1] == """_arguments '*: :(("--overwrite":"Replace existing output files."))'\n"""
    monkeypatch.setenv("_TYPER_COMPLETE_ARGS", "stereo-depth process ")
    assert run()[1] == "_files\n"


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_script_of_a_shell(run: Run, monkeypatch: pytest.MonkeyPatch, shell: str) -> None:
    with monkeypatch.context() as patch:
        patch.setenv("_STEREO_DEPTH_COMPLETE", f"source_{shell}")
        code, script, _ = run()
    assert code == 0
    assert f"_STEREO_DEPTH_COMPLETE=complete_{shell}" in script
    monkeypatch.setattr(shellingham, "detect_shell", lambda: (shell, f"/bin/{shell}"))
    code, shown, _ = run("--show-completion")
    assert (code, shown.strip()) == (0, script.strip())


def test_completion_is_installed_for_the_current_shell(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(shellingham, "detect_shell", lambda: ("bash", "/bin/bash"))
    code, out, _ = run("--install-completion")
    file = tmp_path / ".bash_completions" / "stereo-depth.sh"
    assert code == 0 and str(file) in out
    assert "complete_bash" in file.read_text()
    assert str(file) in (tmp_path / ".bashrc").read_text()


@pytest.mark.parametrize("option", ["--install-completion", "--show-completion"])
def test_an_unknown_shell_is_one_line_with_the_remedy(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, option: str
) -> None:
    def fail() -> tuple[str, str]:
        raise shellingham.ShellDetectionFailure

    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(shellingham, "detect_shell", fail)
    code, out, err = run(option)
    assert (code, out) == (1, "")
    assert err == (
        "error: the shell that runs this command is not known: write the script yourself, "
        "for bash: _STEREO_DEPTH_COMPLETE=source_bash stereo-depth > stereo-depth.sh\n"
    )
    assert not list(tmp_path.iterdir())

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C ends a command with a line on what it leaves, and is not lost in callbacks of the compiler."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine, Run

from stereo_depth_ros.cli import interrupts, kernels, parameters
from stereo_depth_ros.files.output import OutputFile, write_file


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_in_a_callback_ends_the_command(monkeypatch: pytest.MonkeyPatch, number: signal.Signals) -> None:
    def compile_kernels(report: Callable[[int, int], object]) -> None:
        with suppress(KeyboardInterrupt):  # as machine code does that calls Python
            signal.raise_signal(number)

    monkeypatch.setattr(kernels, "compile_kernels", compile_kernels)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            kernels.prepare_kernels()
        assert signal.getsignal(signal.SIGTERM) is signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)


def test_an_interrupt_that_is_lost_in_a_callback_of_c_leaves_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: told.append(lost.exc_type))

    def called_by_c(error: type[BaseException]) -> None:
        def fail() -> None:
            raise error

        ctypes.CFUNCTYPE(None)(fail)()

    with interrupts._lost_interrupts_are_silent():
        called_by_c(interrupts.Interrupted)
        called_by_c(ZeroDivisionError)
    assert told == [ZeroDivisionError]


def test_an_interrupt_ends_the_compilation_before_the_next_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = []

    def compile_kernels(report: Callable[[int, int], object]) -> None:
        for kernel in (1, 2, 3):
            report(kernel, 3)
            compiled.append(kernel)
            if kernel == 1:
                signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(kernels, "compile_kernels", compile_kernels)
    with pytest.raises(KeyboardInterrupt):
        kernels.prepare_kernels()
    assert compiled == [1]


def interrupt_while_writing(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, act: Callable[[], object]) -> str:
    """What a command says that has completed first.txt and is writing second.txt when ``act`` is called."""

    def show(*_: object, **__: object) -> None:
        write_file(folder / "first.txt", "1")
        with OutputFile(folder / "second.txt") as second:
            second.file.write(b"2")
            act()

    monkeypatch.setattr(parameters, "show", show)
    code, out, err = run()
    assert (code, out) == (130, "")
    assert [path.name for path in folder.iterdir()] == ["first.txt"]
    return err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_command_says_what_it_leaves(
    command_line: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    run = command_line("parameters")
    said = interrupt_while_writing(run, tmp_path, monkeypatch, lambda: signal.raise_signal(number))
    assert said == f"interrupted: {tmp_path / 'first.txt'} complete; incomplete {tmp_path / 'second.txt'} removed\n"


def test_a_command_that_does_not_notice_an_interrupt_is_ended(
    command_line: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The main thread goes on, as in a kernel; another one removes what is incomplete and ends the process."""
    codes: list[int] = []
    ended = threading.Event()

    def end(code: int) -> None:
        codes.append(code)
        ended.set()

    def compute() -> None:
        with suppress(interrupts.Interrupted):
            signal.raise_signal(signal.SIGINT)
        assert ended.wait(30)
        raise interrupts.Interrupted  # where the real process would no longer be

    monkeypatch.setattr(interrupts, "_END_S", 0)
    monkeypatch.setattr(os, "_exit", end)
    line = f"interrupted: {tmp_path / 'first.txt'} complete; incomplete {tmp_path / 'second.txt'} removed\n"
    assert interrupt_while_writing(command_line("parameters"), tmp_path, monkeypatch, compute) == 2 * line
    assert codes == [130]


def test_an_interrupt_before_any_output(command_line: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameters, "show", lambda *_, **__: signal.raise_signal(signal.SIGINT))
    assert command_line("parameters")() == (130, "", "interrupted: nothing was written\n")

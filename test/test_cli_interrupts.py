# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C while kernels are compiled or loaded is not lost in callbacks of the compiler."""

from __future__ import annotations

import signal
from collections.abc import Callable
from contextlib import suppress

import pytest

from stereo_depth_ros.cli import output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_in_a_callback_ends_the_command(monkeypatch: pytest.MonkeyPatch, number: signal.Signals) -> None:
    def compile_kernels(report: Callable[[int, int], object]) -> None:
        with suppress(KeyboardInterrupt):  # as machine code does that calls Python
            signal.raise_signal(number)

    monkeypatch.setattr(output, "compile_kernels", compile_kernels)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            output.prepare_kernels()
        assert signal.getsignal(signal.SIGTERM) is signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)


def test_an_interrupt_ends_the_compilation_before_the_next_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = []

    def compile_kernels(report: Callable[[int, int], object]) -> None:
        for kernel in (1, 2, 3):
            report(kernel, 3)
            compiled.append(kernel)
            if kernel == 1:
                signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(output, "compile_kernels", compile_kernels)
    with pytest.raises(KeyboardInterrupt):
        output.prepare_kernels()
    assert compiled == [1]

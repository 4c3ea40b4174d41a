# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compilation of the kernels of a command, with progress; commands without kernels start without numba."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from stereo_depth_ros.cli.output import in_terminal, progress_bar, tell
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.matching import matcher_from_config

__all__ = ["prepare_kernels"]


def prepare_kernels(config: MatchingConfig | None = None) -> None:
    """Compile the kernels of all imported modules, and of the matcher that ``config`` selects, with progress.

    Raises:
        ConfigError: the matcher rejects its parameters.
    """
    if config is not None:
        matcher = matcher_from_config(config)
        if matcher.engine:
            tell(f"matcher {matcher.name}: {matcher.engine}")
    with progress_bar("compiling kernels") as progress, _interrupts_kept() as check:

        def report(number: int, total: int) -> None:
            check()
            if not number:
                tell("waiting for another process that compiles kernels")
            if in_terminal():
                progress(max(number - 1, 0), total)
            elif number:
                tell(f"compiling kernels, {number} of {total}")

        compile_kernels(report)


@contextmanager
def _interrupts_kept() -> Iterator[Callable[[], None]]:
    """Keep SIGINT and SIGTERM until the end of the ``with`` block, or until the yielded function is called.

    Numba calls back from machine code, where an exception that a signal handler raises is printed and lost.
    """
    numbers = (signal.SIGINT, signal.SIGTERM)
    received: list[int] = []

    def set_handlers(handlers: Iterable[Any]) -> list[Any]:
        return [signal.signal(number, handler) for number, handler in zip(numbers, handlers, strict=True)]

    def keep(number: int, _: object) -> None:
        received.append(number)

    def release() -> None:
        if received:
            set_handlers(before)
            signal.raise_signal(received[0])

    before = set_handlers((keep, keep))
    try:
        yield release
        release()
    finally:
        set_handlers(before)

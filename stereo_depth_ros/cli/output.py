# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Output of the commands: progress and messages on stderr, tables or JSON on stdout, JSON in files."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from stereo_depth_ros.camera_files.urls import camera_info_paths
from stereo_depth_ros.cli.tables import TextTable, print_tables
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.core.printable import printable
from stereo_depth_ros.files.output import as_output_errors, write_file
from stereo_depth_ros.matching import matcher_from_config

__all__ = [
    "EXIT_ERROR",
    "EXIT_INCOMPLETE",
    "ProgressLines",
    "parameter_files",
    "prepare_kernels",
    "progress_bar",
    "show",
    "tell",
    "warn",
]

EXIT_ERROR, EXIT_INCOMPLETE = 1, 3

_EVERY_S = 10.0  # between two lines of progress where stderr is not a terminal

_messages = Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)


def tell(text: str) -> None:
    """Print a line to stderr; control characters are shown as escapes."""
    _messages.print(printable(text))


def warn(text: str) -> None:
    """Print a warning."""
    tell(f"warning: {text}")


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Progress during the ``with`` block; call the yielded function with the number done and the total.

    A bar in a terminal, elsewhere a line each ten seconds, so that logs show it.
    """
    if not _messages.is_terminal:
        yield ProgressLines(title)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_messages, transient=True) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


class ProgressLines:
    """Progress as a line each ten seconds, with the time left at the rate since the first one done.

    Args:
        title: what is done.
        clock: seconds, monotonic.
    """

    def __init__(self, title: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._title = title
        self._clock = clock
        self._said_at = clock()
        self._first: tuple[float, int] | None = None  # what is compiled and read before it tells nothing of the rate

    def __call__(self, done: int, total: int) -> None:
        now = self._clock()
        if self._first is None and done > 0:
            self._first = now, done
        if now - self._said_at < _EVERY_S:
            return
        self._said_at = now
        tell(f"{self._title}: {done} of {total}{self._left(now, done, total)}")

    def _left(self, now: float, done: int, total: int) -> str:
        if self._first is None or done <= self._first[1] or total <= done:
            return ""
        since, before = self._first
        left_s = round((total - done) * (now - since) / (done - before))
        return f", about {left_s} s left" if left_s < 120 else f", about {round(left_s / 60)} min left"


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
            if _messages.is_terminal:
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


def show(tables: Iterable[TextTable], values: Any, json_file: Path | None, *, overwrite: bool = False) -> None:
    """Print the tables, and write the JSON file if one is given; with "-" print JSON only.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it or stdout cannot be written.
    """
    text = json.dumps(values, indent=2) + "\n"
    if json_file is not None and str(json_file) != "-":
        write_file(json_file, text, overwrite=overwrite)
    with as_output_errors("standard output"):
        if str(json_file) == "-":
            sys.stdout.write(text)
        else:
            print_tables(tables)


def parameter_files(params_file: Path | None, values: Mapping[str, Any]) -> list[Path]:
    """The parameter file, and the files named in parameters."""
    left_url, right_url = (str(values.get(f"{side}_camera_info_url") or "") for side in ("left", "right"))
    files = [Path(path) for path in (params_file, values.get("onnx_model")) if path]
    return [*files, *camera_info_paths(left_url, right_url)]

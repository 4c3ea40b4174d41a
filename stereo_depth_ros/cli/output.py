# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Output of the commands: progress and messages on stderr, tables or JSON on stdout, JSON in files."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.files.output import as_output_errors, write_file
from stereo_depth_ros.matching import matcher_from_config

__all__ = [
    "EXIT_ERROR",
    "EXIT_INCOMPLETE",
    "messages",
    "parameter_files",
    "prepare_kernels",
    "progress_bar",
    "show",
    "warn",
]

EXIT_ERROR, EXIT_INCOMPLETE = 1, 3

messages = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)


def warn(text: str) -> None:
    """Print a warning."""
    messages.print(f"warning: {text}")


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar during the ``with`` block; call the yielded function with the number done and the total."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=messages, transient=True, disable=not messages.is_terminal) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def prepare_kernels(config: MatchingConfig | None = None) -> None:
    """Compile the kernels of all imported modules, and of the matcher that ``config`` selects, with progress.

    Raises:
        ConfigError: the matcher rejects its parameters.
    """
    if config is not None:
        matcher_from_config(config)
    with progress_bar("compiling kernels") as progress, _interrupts_kept() as check:

        def report(number: int, total: int) -> None:
            check()
            progress(max(number - 1, 0), total)
            if not number:
                messages.print("waiting for another process that compiles kernels")
            elif not messages.is_terminal:
                messages.print(f"compiling kernels, {number} of {total}")

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


def show(tables: Iterable[RenderableType], values: Any, json_file: Path | None, *, overwrite: bool = False) -> None:
    """Print the tables separated by blank lines, and write the JSON file if one is given; with "-" print JSON only.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it or stdout cannot be written.
    """
    text = json.dumps(values, indent=2) + "\n"
    if json_file is not None and str(json_file) != "-":
        write_file(json_file, text, overwrite=overwrite)
    console = Console(highlight=False)
    with as_output_errors("standard output"):
        if str(json_file) == "-":
            console.file.write(text)
            return
        for number, table in enumerate(tables):
            if number:
                console.print()
            console.print(table)


def parameter_files(params_file: Path | None, values: Mapping[str, Any]) -> list[Path]:
    """The parameter file, and the files named in parameters."""
    return [Path(path) for path in (params_file, values.get("onnx_model")) if path]

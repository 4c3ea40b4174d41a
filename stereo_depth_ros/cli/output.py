# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the command line shows things: progress on stderr, tables or JSON on stdout, JSON in files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.files.output import telling, write_file
from stereo_depth_ros.matching import matcher_from_config

__all__ = [
    "EXIT_ERROR",
    "EXIT_LOST",
    "messages",
    "parameter_files",
    "prepare_kernels",
    "progress_bar",
    "show",
]

EXIT_ERROR, EXIT_LOST = 1, 3

messages = Console(stderr=True, highlight=False, soft_wrap=True)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar while the block lasts; call what it gives with the number done and the number to do."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=messages, transient=True, disable=not messages.is_terminal) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def prepare_kernels(config: MatchingConfig | None = None) -> None:
    """Compile the kernels of the modules imported so far, and of a matcher, before the work, and report each.

    Raises:
        ConfigError: the matcher refuses its parameters.
    """
    if config is not None:
        matcher_from_config(config)
    with progress_bar("compiling kernels") as progress:

        def report(number: int, total: int) -> None:
            progress(number - 1, total)
            if not messages.is_terminal:
                messages.print(f"compiling kernels, {number} of {total}")

        compile_kernels(report)


def show(tables: Iterable[RenderableType], values: Any, json_file: Path | None, *, overwrite: bool = False) -> None:
    """Print the tables, a blank line between them; with a file write JSON there instead, "-" is stdout.

    Raises:
        OutputError: the file exists and ``overwrite`` is false, or it or stdout cannot be written.
    """
    text = json.dumps(values, indent=2) + "\n"
    if json_file is not None and str(json_file) != "-":
        write_file(json_file, text, overwrite=overwrite)
    console = Console(highlight=False)
    with telling("standard output"):
        if str(json_file) == "-":
            console.file.write(text)
            return
        for number, table in enumerate(tables):
            if number:
                console.print()
            console.print(table)


def parameter_files(params_file: Path | None, values: Mapping[str, Any]) -> list[Path]:
    """The files that parameters are read from, and those that they name."""
    return [Path(path) for path in (params_file, values.get("onnx_model")) if path]

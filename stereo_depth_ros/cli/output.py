# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the command line shows things: progress on stderr, tables or JSON on stdout, JSON in files."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.files.output import telling, write_file

__all__ = ["Overwrite", "finish_stdout", "messages", "parameter_files", "progress_bar", "show"]

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace outputs that exist.")]

messages = Console(stderr=True, highlight=False, soft_wrap=True)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar while the block lasts; call what it gives with the number done and the number to do."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=messages, transient=True, disable=not messages.is_terminal) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


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


def finish_stdout() -> None:
    """Write what stdout still holds; who has closed the pipe it goes to is told nothing.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        with telling("standard output"):
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()
        sys.exit(1)
    except OutputError:
        _drop_stdout()
        raise


def parameter_files(params_file: Path | None, values: Mapping[str, Any]) -> list[Path]:
    """The files that parameters are read from, and those that they name."""
    return [Path(path) for path in (params_file, values.get("onnx_model")) if path]


def _drop_stdout() -> None:
    """Python would try once more at its end, and complain."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the command line shows things: progress on stderr, tables or JSON on stdout."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from stereo_depth_ros.core.errors import BagError

__all__ = ["messages", "progress_bar", "show"]

messages = Console(stderr=True, highlight=False, soft_wrap=True)


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar while the block lasts; call what it gives with the number done and the number to do."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=messages, transient=True, disable=not messages.is_terminal) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def show(tables: Iterable[RenderableType], values: Any, json_file: Path | None) -> None:
    """Print the tables, a blank line between them; with a file write JSON there instead, "-" is stdout.

    Raises:
        BagError: the file cannot be written.
    """
    console = Console(highlight=False)
    if json_file is not None:
        text = json.dumps(values, indent=2) + "\n"
        if str(json_file) == "-":
            console.file.write(text)
            return
        try:
            json_file.write_text(text, encoding="utf-8")
        except OSError as error:
            raise BagError(f"cannot write {json_file}: {error.strerror}") from error
    for number, table in enumerate(tables):
        if number:
            console.print()
        console.print(table)

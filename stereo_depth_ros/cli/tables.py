# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table layouts shared by the commands; all cells are plain text, whatever names of topics and files hold."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console
from rich.table import Table
from rich.text import Text

from stereo_depth_ros.core.printable import printable

__all__ = ["TextTable", "facts_table", "plain_table", "print_tables"]

_NO_LIMIT = 1_000_000  # characters of a line


class TextTable:
    """Rows of plain text: no markup is read from a cell, and control characters are shown as escapes.

    Args:
        columns: titles; one that ends in ":r" makes a column of numbers, right-aligned and not wrapped. A line feed
            in a title breaks it in a terminal.
        title: a line above the table; empty for none.
        headless: without the row of titles, as in a table of names and values.
    """

    def __init__(self, *columns: str, title: str = "", headless: bool = False) -> None:
        self._columns = columns
        self._title = title
        self._headless = headless
        self._rows: list[tuple[Text, ...]] = []

    def add_row(self, *cells: str | Text) -> None:
        """Add a row; a cell with a style is a ``Text`` of the program's own words."""
        self._rows.append(tuple(cell if isinstance(cell, Text) else Text(printable(cell)) for cell in cells))

    def print(self, console: Console, whole_lines: bool) -> None:
        """Print it; with ``whole_lines`` a record is one line, else it is wrapped at the width of the console."""
        table = Table(show_header=not self._headless, box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for number, column in enumerate(self._columns):
            name, _, right = column.partition(":")
            style = "dim" if self._headless and not number else ""
            table.add_column(
                Text(name.replace("\n", " ") if whole_lines else name),
                justify="right" if right else "left",
                overflow="fold",
                no_wrap=bool(right),
                header_style="dim",
                style=style,
            )
        for row in self._rows:
            table.add_row(*row)
        if self._title:
            console.print(Text(self._title, style="bold"), soft_wrap=whole_lines)
        console.print(table)


def plain_table(*columns: str, title: str = "") -> TextTable:
    """A table with column titles, see :class:`TextTable`."""
    return TextTable(*columns, title=title)


def facts_table() -> TextTable:
    """A table of names and values without column titles."""
    return TextTable("", "", headless=True)


def print_tables(tables: Iterable[TextTable]) -> None:
    """Print tables to stdout, separated by blank lines; where it is not a terminal, each record is one line."""
    console = Console(highlight=False, markup=False, emoji=False)
    whole_lines = not console.file.isatty()
    if whole_lines:
        console.width = _NO_LIMIT
    for number, table in enumerate(tables):
        with console.capture() as captured:
            table.print(console, whole_lines)
        lines = captured.get().splitlines()
        console.file.write("\n".join(([""] if number else []) + [line.rstrip() for line in lines]) + "\n")

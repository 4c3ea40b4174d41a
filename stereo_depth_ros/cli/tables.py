# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table layouts shared by the commands."""

from __future__ import annotations

from rich.table import Table

__all__ = ["facts_table", "plain_table"]


def plain_table(*columns: str, title: str | None = None) -> Table:
    """A table with column titles; one that ends in ":r" makes a column of numbers, right-aligned and not wrapped."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for column in columns:
        name, _, right = column.partition(":")
        table.add_column(
            name, justify="right" if right else "left", overflow="fold", no_wrap=bool(right), header_style="dim"
        )
    return table


def facts_table() -> Table:
    """A table of names and values without column titles."""
    table = Table(show_header=False, box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim")
    table.add_column(overflow="fold")
    return table

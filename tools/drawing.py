# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The drawing of the packages and the imports between them, as SVG without any library."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from architecture import ORDER, PACKAGE, part_of, read_imports

__all__ = ["draw_imports", "render_drawing"]

_CELL = 28
_MARGIN = 16
_NAME_WIDTH = 92  # px, of the longest name
_INK, _PALE, _FILL, _EDGE = "#1f2933", "#c9d4e0", "#e4edf7", "#3a6ea5"


def render_drawing(root: Path) -> str:
    """The SVG of the source tree ``root``."""
    pairs = {(part_of(found.importer), part_of(found.imported)) for found in read_imports(root)}
    names = [name if (root / PACKAGE / name).is_dir() else f"{name}.py" for name in ORDER]
    edges = {(ORDER.index(a), ORDER.index(b)) for a, b in pairs if a != b and a in ORDER and b in ORDER}
    last = len(ORDER) - 1
    return draw_imports(names[::-1], {(last - a, last - b) for a, b in edges})


def draw_imports(names: Sequence[str], edges: set[tuple[int, int]]) -> str:
    """Names on the diagonal, the highest at the top left; a dot in the row of the importer, above what it imports.

    Args:
        names: highest first.
        edges: positions of importer and imported; all dots are right of the diagonal where imports point downward.
    """
    size = len(names)
    left = _MARGIN + _NAME_WIDTH
    width, height = left + size * _CELL + _MARGIN, size * _CELL + 2 * _MARGIN
    body = [f'<rect width="{width}" height="{height}" fill="#ffffff"/>']
    for row in range(size):
        x, y = _center(row)
        ends = [_center(b)[0] for a, b in edges if a == row]
        starts = [_center(a)[1] for a, b in edges if b == row]
        if ends:
            body.append(_line(x, y, max(ends), y))
        if starts:
            body.append(_line(x, min(starts), x, y))
    for a, b in sorted(edges):
        title = f"<title>{names[a]} imports {names[b]}</title>"
        body.append(f'<circle cx="{_center(b)[0]}" cy="{_center(a)[1]}" r="4.5" fill="{_EDGE}">{title}</circle>')
    for row, name in enumerate(names):
        body += _box(row, name)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    style = f'font-family="Helvetica, Arial, sans-serif" font-size="14" fill="{_INK}">'
    return "\n".join([f"{head} {style}", *body, "</svg>", ""])


def _center(position: int) -> tuple[int, int]:
    """x and y of a name's end on the diagonal."""
    return _MARGIN + _NAME_WIDTH + position * _CELL + _CELL // 2, _MARGIN + position * _CELL + _CELL // 2


def _line(x1: int, y1: int, x2: int, y2: int) -> str:
    return f'<path d="M{x1} {y1}L{x2} {y2}" stroke="{_PALE}" stroke-width="1.5"/>'


def _box(position: int, name: str) -> list[str]:
    """A package is filled, a single module is not."""
    x, y = _center(position)
    half, fill = _CELL // 2 - 3, "#ffffff" if name.endswith(".py") else _FILL
    left, width = x - _NAME_WIDTH, _NAME_WIDTH + half
    return [
        f'<rect x="{left}" y="{y - half}" width="{width}" height="{2 * half}" rx="4" fill="{fill}" stroke="{_EDGE}"/>',
        f'<text x="{left + width / 2:g}" y="{y + 5}" text-anchor="middle">{name}</text>',
    ]

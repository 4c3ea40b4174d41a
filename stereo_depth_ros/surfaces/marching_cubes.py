# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Marching cubes: the triangles in each of the 256 kinds of cubes, made from one rule for the faces."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["CORNERS", "EDGES", "CubeTables", "cube_tables"]

# Corner number: x + 2 y + 4 z. Edge number: 4 axis + b + 2 c, from the corner with the coordinates b and c along the
# two axes that follow in the order x, y, z, x, ...
CORNERS = tuple((corner & 1, (corner >> 1) & 1, corner >> 2) for corner in range(8))


def _edge_ends(edge: int) -> tuple[int, int]:
    axis, b, c = edge >> 2, edge & 1, (edge >> 1) & 1
    start = (b << ((axis + 1) % 3)) | (c << ((axis + 2) % 3))
    return start, start | (1 << axis)


EDGES = tuple(_edge_ends(edge) for edge in range(12))
_EDGE_OF = {frozenset(ends): edge for edge, ends in enumerate(EDGES)}


@dataclass(frozen=True, eq=False)
class CubeTables:
    """What is in each kind of cube; the kind has a bit for each corner that is inside.

    Attributes:
        edges: int32 (256,), a bit for each edge that the surface crosses.
        counts: int64 (256,), number of triangles.
        triangles: int8 (256, N), the edges on which the corners of the triangles are, three for each triangle,
            counter-clockwise seen from outside.
    """

    edges: npt.NDArray[np.int32]
    counts: npt.NDArray[np.int64]
    triangles: npt.NDArray[np.int8]


@functools.cache
def cube_tables() -> CubeTables:
    """The tables (Lorensen and Cline 1987), in which cubes that share a face agree about it.

    On each face, a line joins the two ends of each run of corners that are inside. That depends on the corners of the
    face alone, so that the surface has no gap between two cubes, also where two diagonal corners are inside, as it had
    with the tables of 1987 (Durst 1988). The lines of all faces make closed loops, which are cut into triangles,
    without a side in a face other than these lines.
    """
    found = [[triangle for loop in _loops(kind) for triangle in _triangles(loop)] for kind in range(256)]
    longest = max(len(triangles) for triangles in found)
    table = np.zeros((256, 3 * longest), np.int8)
    for kind, triangles in enumerate(found):
        table[kind, : 3 * len(triangles)] = np.ravel(np.array(triangles, np.int8))
    crossed = [
        sum(1 << edge for edge, (a, b) in enumerate(EDGES) if (kind >> a ^ kind >> b) & 1) for kind in range(256)
    ]
    return CubeTables(np.array(crossed, np.int32), np.array([len(t) for t in found], np.int64), table)


def _faces() -> Iterator[list[int]]:
    """The corners of each face, counter-clockwise seen from outside."""
    for axis in range(3):
        b, c = 1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3)
        around = [0, b, b | c, c]
        yield around[::-1]
        yield [corner | (1 << axis) for corner in around]


_FACES = tuple(_faces())
_SHARING = frozenset(
    frozenset((one, other))
    for one, other in combinations(range(12), 2)
    if any({*EDGES[one], *EDGES[other]} <= {*face} for face in _FACES)
)


def _loops(kind: int) -> list[list[int]]:
    """The closed loops of edges in a kind of cube, outside to the left of them seen from outside of the cube."""
    following: dict[int, int] = {}
    for face in _FACES:
        inside = [bool(kind >> corner & 1) for corner in face]
        edges = [_EDGE_OF[frozenset((face[i], face[(i + 1) % 4]))] for i in range(4)]
        for i in range(4):
            if inside[i] or not inside[(i + 1) % 4]:
                continue
            end = next(j for j in range(i + 1, i + 5) if inside[j % 4] and not inside[(j + 1) % 4])
            following[edges[i]] = edges[end % 4]
    loops = []
    while following:
        start, edge = next(iter(following.items()))
        loop = [start]
        del following[start]
        while edge != start:
            loop.append(edge)
            edge = following.pop(edge)
        loops.append(loop)
    return loops


def _triangles(loop: list[int]) -> list[tuple[int, int, int]]:
    """The loop as triangles: of all ways to cut it, the first one with the fewest cuts in a face."""
    return min(_cuts(tuple(loop)), key=_cuts_in_faces(loop))


def _cuts(loop: tuple[int, ...]) -> Iterator[list[tuple[int, int, int]]]:
    """All ways to cut a loop into triangles: each has one triangle at the side from the last to the first."""
    if len(loop) < 3:
        yield []
        return
    for i in range(1, len(loop) - 1):
        for before in _cuts(loop[: i + 1]):
            for after in _cuts(loop[i:]):
                yield [(loop[0], loop[i], loop[-1]), *before, *after]


def _cuts_in_faces(loop: list[int]) -> Any:
    sides = {frozenset((one, other)) for one, other in zip(loop, [*loop[1:], loop[0]], strict=True)}

    def count(triangles: list[tuple[int, int, int]]) -> int:
        cuts = {frozenset(pair) for triangle in triangles for pair in combinations(triangle, 2)} - sides
        return len(cuts & _SHARING)

    return count

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels that extract the surface of a volume of signed distances: kinds of cubes, vertices, triangles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.surfaces.volume_kernels import SIDE, VOXELS, find, key_of

__all__ = ["NEAR", "distances_at", "fill_cubes", "find_kinds", "find_near", "make_vertices", "mark_edges"]

NEAR = 27  # blocks around a block, itself in the middle

_KEYS, _BLOCKS = "int64[::1]", "int32[::1]"
_F32, _U8, _I32, _I64 = "float32[:, ::1]", "uint8[:, ::1]", "int32[:, ::1]", "int64[::1]"


@compiled(f"void(int64, int64, {_I32}, {_KEYS}, {_BLOCKS}, {_I32})")
def find_near(first: int, last: int, coordinates: Any, keys: Any, blocks: Any, near: Any) -> None:
    """The blocks around each block.

    Args:
        first, last: blocks.
        coordinates: int32 (N, 3).
        keys, blocks: the table.
        near: int32 (N, 27), written: numbers, x fastest, -1 where there is none.
    """
    for block in range(first, last):
        bx, by, bz = coordinates[block, 0], coordinates[block, 1], coordinates[block, 2]
        for i in range(NEAR):
            near[block, i] = find(keys, blocks, key_of(bx + i % 3 - 1, by + (i // 3) % 3 - 1, bz + i // 9 - 1))


@compiled(allocates=False)
def _locate(near: Any, block: int, x: int, y: int, z: int) -> tuple[int, int]:
    """Block and number of a grid point at x, y, z from the beginning of ``block``, -8 to 15; block -1 without one."""
    other = near[block, 9 * ((z >> 3) + 1) + 3 * ((y >> 3) + 1) + (x >> 3) + 1]
    return other, ((z & 7) << 6) | ((y & 7) << 3) | (x & 7)


@compiled(f"void(int64, int64, {_I32}, {_F32}, {_F32}, {_U8})")
def find_kinds(first: int, last: int, near: Any, distance: F32, weight: F32, kinds: U8) -> None:
    """The kind of the cube that begins at each grid point: a bit for each corner behind the surface.

    0 where nothing is to be drawn, as also where one of the corners is unknown.

    Args:
        first, last: blocks.
        near: of :func:`find_near`.
        distance, weight: float32 (N, 512).
        kinds: uint8 (N, 512), written.
    """
    for block in range(first, last):
        for voxel in range(VOXELS):
            x, y, z = voxel & 7, (voxel >> 3) & 7, voxel >> 6
            kind = 0
            for corner in range(8):
                other, place = _locate(near, block, x + (corner & 1), y + ((corner >> 1) & 1), z + (corner >> 2))
                if other < 0 or not weight[other, place] > 0.0:
                    kind = 0
                    break
                if distance[other, place] < 0.0:
                    kind |= 1 << corner
            kinds[block, voxel] = 0 if kind == 255 else kind


@compiled(f"int64({_I32}, {_U8}, {_BLOCKS}, {_U8}, {_I32})")
def mark_edges(near: Any, kinds: U8, edges: Any, marks: U8, numbers: Any) -> int:
    """Mark the edges that cubes cross, each at the grid point where it begins, and number their vertices.

    Args:
        near: of :func:`find_near`.
        kinds: of :func:`find_kinds`.
        edges: int32 (256,), of the cube tables.
        marks: uint8 (N, 512), 0; written: a bit for each axis.
        numbers: int32 (N, 512), written: the first vertex of each grid point.

    Returns:
        The number of vertices.
    """
    for block in range(kinds.shape[0]):
        for voxel in range(VOXELS):
            crossed = edges[kinds[block, voxel]]
            if crossed == 0:
                continue
            x, y, z = voxel & 7, (voxel >> 3) & 7, voxel >> 6
            for edge in range(12):
                if crossed & (1 << edge):
                    other, place, axis = _edge(near, block, x, y, z, edge)
                    marks[other, place] |= np.uint8(1 << axis)
    count = 0
    for block in range(kinds.shape[0]):
        for voxel in range(VOXELS):
            numbers[block, voxel] = count
            mark = marks[block, voxel]
            count += (mark & 1) + ((mark >> 1) & 1) + (mark >> 2)
    return count


@compiled(allocates=False)
def _edge(near: Any, block: int, x: int, y: int, z: int, edge: int) -> tuple[int, int, int]:
    """Block and grid point at which an edge of a cube begins, and its axis."""
    axis, b, c = edge >> 2, edge & 1, (edge >> 1) & 1
    if axis == 0:
        other, place = _locate(near, block, x, y + b, z + c)
    elif axis == 1:
        other, place = _locate(near, block, x + c, y, z + b)
    else:
        other, place = _locate(near, block, x + b, y + c, z)
    return other, place, axis


@compiled(allocates=False)
def _slope(
    near: Any, distance: F32, weight: F32, block: int, x: int, y: int, z: int, dx: int, dy: int, dz: int
) -> float:
    """Derivative of the distance along an axis, per grid step: central, or of one side where the other is unknown."""
    here, at = _locate(near, block, x, y, z)
    before, p = _locate(near, block, x - dx, y - dy, z - dz)
    after, q = _locate(near, block, x + dx, y + dy, z + dz)
    low = high = float(distance[here, at])
    steps = 0.0
    if before >= 0 and weight[before, p] > 0.0:
        low, steps = float(distance[before, p]), steps + 1.0
    if after >= 0 and weight[after, q] > 0.0:
        high, steps = float(distance[after, q]), steps + 1.0
    return (high - low) / max(steps, 1.0)


@compiled(
    f"void(int64, int64, {_I32}, {_I32}, {_F32}, {_F32}, uint8[:, :, ::1], {_U8}, {_I32}, float64, {_F32}, {_F32}, "
    f"{_U8}, float32[::1])"
)
def make_vertices(
    first: int,
    last: int,
    coordinates: Any,
    near: Any,
    distance: F32,
    weight: F32,
    color: U8,
    marks: U8,
    numbers: Any,
    voxel_m: float,
    points: F32,
    normals: F32,
    colors: U8,
    sigma: F32,
) -> None:
    """The vertices of the edges that begin in some blocks, where the distance, linear along the edge, is 0.

    Args:
        first, last: blocks.
        coordinates: int32 (N, 3), of the blocks.
        near: of :func:`find_near`.
        distance, weight: float32 (N, 512).
        color: uint8 (N, 512, 3).
        marks, numbers: of :func:`mark_edges`.
        voxel_m: between grid points.
        points: float32 (M, 3), written, m.
        normals: float32 (M, 3), written: unit vectors along the gradient of the distance, to the outside.
        colors: uint8 (M, 3), written.
        sigma: float32 (M,), written: 1 / sqrt(weight), m.
    """
    for block in range(first, last):
        for voxel in range(VOXELS):
            mark = marks[block, voxel]
            if mark == 0:
                continue
            x, y, z = voxel & 7, (voxel >> 3) & 7, voxel >> 6
            vertex = numbers[block, voxel]
            for axis in range(3):
                if not mark & (1 << axis):
                    continue
                dx, dy, dz = int(axis == 0), int(axis == 1), int(axis == 2)
                other, place = _locate(near, block, x + dx, y + dy, z + dz)
                d0, d1 = float(distance[block, voxel]), float(distance[other, place])
                t = d0 / (d0 - d1)
                points[vertex, 0] = (SIDE * coordinates[block, 0] + x + t * dx) * voxel_m
                points[vertex, 1] = (SIDE * coordinates[block, 1] + y + t * dy) * voxel_m
                points[vertex, 2] = (SIDE * coordinates[block, 2] + z + t * dz) * voxel_m
                ex, ey, ez = x + dx, y + dy, z + dz
                gx = (1.0 - t) * _slope(near, distance, weight, block, x, y, z, 1, 0, 0)
                gy = (1.0 - t) * _slope(near, distance, weight, block, x, y, z, 0, 1, 0)
                gz = (1.0 - t) * _slope(near, distance, weight, block, x, y, z, 0, 0, 1)
                gx += t * _slope(near, distance, weight, block, ex, ey, ez, 1, 0, 0)
                gy += t * _slope(near, distance, weight, block, ex, ey, ez, 0, 1, 0)
                gz += t * _slope(near, distance, weight, block, ex, ey, ez, 0, 0, 1)
                length = math.sqrt(gx * gx + gy * gy + gz * gz)
                if not length > 0.0:  # along the edge it is not 0
                    gx, gy, gz = dx * (d1 - d0), dy * (d1 - d0), dz * (d1 - d0)
                    length = abs(d1 - d0)
                normals[vertex, 0], normals[vertex, 1], normals[vertex, 2] = gx / length, gy / length, gz / length
                for c in range(3):
                    level = (1.0 - t) * color[block, voxel, c] + t * color[other, place, c]
                    colors[vertex, c] = np.uint8(level + 0.5)
                mean = (1.0 - t) * weight[block, voxel] + t * weight[other, place]
                sigma[vertex] = 1.0 / math.sqrt(mean)
                vertex += 1


@compiled(f"void(int64, int64, {_I32}, {_U8}, {_U8}, {_I32}, {_I64}, int8[:, ::1], {_I64}, {_I32})")
def fill_cubes(
    first: int,
    last: int,
    near: Any,
    kinds: U8,
    marks: U8,
    numbers: Any,
    counts: Any,
    table: Any,
    starts: Any,
    triangles: Any,
) -> None:
    """The triangles of the cubes of some blocks.

    Args:
        first, last: blocks.
        near: of :func:`find_near`.
        kinds: of :func:`find_kinds`.
        marks, numbers: of :func:`mark_edges`.
        counts, table: int64 (256,) and int8 (256, K), of the cube tables.
        starts: int64 (N,), the first triangle of each block.
        triangles: int32 (M, 3), written.
    """
    for block in range(first, last):
        n = starts[block]
        for voxel in range(VOXELS):
            kind = kinds[block, voxel]
            if counts[kind] == 0:
                continue
            x, y, z = voxel & 7, (voxel >> 3) & 7, voxel >> 6
            for i in range(counts[kind]):
                for corner in range(3):
                    edge = table[kind, 3 * i + corner]
                    other, place, axis = _edge(near, block, x, y, z, edge)
                    before = marks[other, place] & ((1 << axis) - 1)
                    triangles[n, corner] = numbers[other, place] + (before & 1) + (before >> 1)
                n += 1


@compiled(f"void({_F32}, {_F32}, {_KEYS}, {_BLOCKS}, float64[:, ::1], float64, float64[::1])")
def distances_at(distance: F32, weight: F32, keys: Any, blocks: Any, points: F64, voxel_m: float, found: F64) -> None:
    """The distance at the grid point next to each point; NaN where it is unknown.

    Args:
        distance, weight: float32 (N, 512).
        keys, blocks: the table.
        points: float64 (M, 3), m.
        voxel_m: between grid points.
        found: float64 (M,), written, m.
    """
    for i in range(points.shape[0]):
        x, y, z = (
            math.floor(points[i, 0] / voxel_m + 0.5),
            math.floor(points[i, 1] / voxel_m + 0.5),
            math.floor(points[i, 2] / voxel_m + 0.5),
        )
        block = find(keys, blocks, key_of(x >> 3, y >> 3, z >> 3))
        found[i] = np.nan
        if block >= 0:
            voxel = ((z & 7) << 6) | ((y & 7) << 3) | (x & 7)
            if weight[block, voxel] > 0.0:
                found[i] = distance[block, voxel]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels of registration: corresponding points, their distances along the normals, and the normal equations."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64

__all__ = ["CHUNK", "OTHERWISE", "OUTSIDE", "accumulate", "measure", "nearest", "project"]

CHUNK = 2048  # points whose sums are added up first

# Instead of the number of a corresponding point: there is none, or one that faces another way or is too far away.
OUTSIDE, OTHERWISE = -1, -2

_ALONG = 0.99  # of the squared distance along a normal, the share that does not count
_ROUNDING = 2.0**-22  # of two points, relative to the depth; counts where their standard deviation is 0

_P, _V, _M, _I, _L = "float32[:, ::1]", "float32[::1]", "float64[:, ::1]", "int32[::1]", "int64[::1]"


@compiled(allocates=False)
def _moved(points: F32, i: int, R: F64, t: F64) -> tuple[float, float, float]:
    x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0],
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1],
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2],
    )


@compiled(allocates=False)
def _turned(vectors: F32, i: int, R: F64) -> tuple[float, float, float]:
    x, y, z = float(vectors[i, 0]), float(vectors[i, 1]), float(vectors[i, 2])
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@compiled(
    f"void(int64, int64, {_P}, {_P}, {_M}, float64[::1], {_P}, {_P}, int64, int64, float64[::1], float64, float64, "
    f"{_I})"
)
def project(
    first: int,
    last: int,
    points: F32,
    normals: F32,
    R: F64,
    t: F64,
    target_points: F32,
    target_normals: F32,
    width: int,
    height: int,
    camera: F64,
    least_cosine: float,
    reach: float,
    index: Any,
) -> None:
    """The pixel of the target that each point is projected to (Blais and Levine 1995).

    Args:
        first, last: points.
        points, normals: float32 (N, 3), of the source, in its frame; finite.
        R, t: float64 (3, 3) and (3,), from the frame of the source to that of the target.
        target_points, target_normals: float32 (H * W, 3), NaN where there is none.
        width, height: of the target, px.
        camera: float64 (4,), fx, fy, cx, cy of the target, px.
        least_cosine: of the angle between both normals.
        reach: the largest distance of both points, relative to the depth.
        index: int32 (N,), written: number of the pixel, OUTSIDE or OTHERWISE.
    """
    for i in range(first, last):
        index[i] = OUTSIDE
        x, y, z = _moved(points, i, R, t)
        if not z > 0.0:
            continue
        u, v = camera[0] * x / z + camera[2] + 0.5, camera[1] * y / z + camera[3] + 0.5
        if not (u >= 0.0 and v >= 0.0 and u < width and v < height):
            continue
        j = int(v) * width + int(u)
        if not math.isfinite(target_normals[j, 0]):
            continue
        a, b, c = _turned(normals, i, R)
        dx, dy, dz = x - target_points[j, 0], y - target_points[j, 1], z - target_points[j, 2]
        cosine = a * target_normals[j, 0] + b * target_normals[j, 1] + c * target_normals[j, 2]
        near = dx * dx + dy * dy + dz * dz <= (reach * z) ** 2
        index[i] = j if cosine >= least_cosine and near else OTHERWISE


@compiled(allocates=False)
def _first_at_least(keys: Any, key: int) -> int:
    low, high = 0, keys.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@compiled(f"void(int64, int64, {_P}, {_P}, {_M}, float64[::1], {_P}, {_P}, {_L}, {_L}, {_M}, float64, float64, {_I})")
def nearest(
    first: int,
    last: int,
    points: F32,
    normals: F32,
    R: F64,
    t: F64,
    target_points: F32,
    target_normals: F32,
    keys: Any,
    counts: Any,
    grid: F64,
    cell: float,
    least_cosine: float,
    index: Any,
) -> None:
    """The point of the target that is nearest to the normal of each point (Chen and Medioni 1992), found by a grid.

    The nearest point itself (Besl and McKay 1992) would be the one whose error is most like that of the point.

    Args:
        first, last: points.
        points, normals, R, t: as of :func:`project`.
        target_points, target_normals: float32 (M, 3), in the order of their cells.
        keys: int64 (M,), the cell of each target point, ascending: (z * counts[1] + y) * counts[0] + x.
        counts: int64 (3,), number of cells along x, y, z.
        grid: float64 (1, 3), the corner of the grid, m.
        cell: size of a cell, and largest distance of both points, m.
        least_cosine: of the angle between both normals; points that face another way are skipped.
        index: int32 (N,), written: number of the target point, OUTSIDE or OTHERWISE.
    """
    for i in range(first, last):
        index[i] = OUTSIDE
        x, y, z = _moved(points, i, R, t)
        a, b, c = _turned(normals, i, R)
        fx, fy, fz = (x - grid[0, 0]) / cell, (y - grid[0, 1]) / cell, (z - grid[0, 2]) / cell
        if not (fx > -1.0 and fy > -1.0 and fz > -1.0):
            continue
        if not (fx < counts[0] + 1.0 and fy < counts[1] + 1.0 and fz < counts[2] + 1.0):
            continue
        cx, cy, cz = math.floor(fx), math.floor(fy), math.floor(fz)
        best = np.inf
        for kz in range(max(cz - 1, 0), min(cz + 2, counts[2])):
            for ky in range(max(cy - 1, 0), min(cy + 2, counts[1])):
                row = (kz * counts[1] + ky) * counts[0]  # the cells of a row stand one after another
                k = _first_at_least(keys, row + max(cx - 1, 0))
                end = row + min(cx + 1, counts[0] - 1)
                while k < keys.shape[0] and keys[k] <= end:
                    dx, dy, dz = x - target_points[k, 0], y - target_points[k, 1], z - target_points[k, 2]
                    squared = dx * dx + dy * dy + dz * dz
                    beside = squared - _ALONG * (a * dx + b * dy + c * dz) ** 2
                    if squared <= cell * cell and beside < best:
                        n = target_normals
                        if a * n[k, 0] + b * n[k, 1] + c * n[k, 2] >= least_cosine:
                            best = beside
                            index[i] = k
                        elif index[i] == OUTSIDE:
                            index[i] = OTHERWISE
                    k += 1


@compiled(f"void(int64, int64, {_P}, {_V}, {_M}, float64[::1], {_P}, {_P}, {_V}, {_I}, {_V}, {_V})")
def measure(
    first: int,
    last: int,
    points: F32,
    sigma: F32,
    R: F64,
    t: F64,
    target_points: F32,
    target_normals: F32,
    target_sigma: F32,
    index: Any,
    spread: F32,
    residual: F32,
) -> None:
    """The distance of each point from the plane of the corresponding one, in standard deviations.

    The standard deviation of a depth acts along the ray of its pixel; what of it is along the normal counts.

    Args:
        first, last: points.
        points, sigma, R, t: float32 (N, 3), (N,), and the pose, as of :func:`project`.
        target_points, target_normals, target_sigma: float32 (M, 3), (M, 3), (M,); sigma is that along the normal, m.
        index: int32 (N,), the corresponding points.
        spread: float32 (N,), written: standard deviation of the distance, m.
        residual: float32 (N,), written: the distance, divided by it; NaN without a corresponding point.
    """
    for i in range(first, last):
        j = index[i]
        if j < 0:
            spread[i] = residual[i] = np.nan
            continue
        x, y, z = _moved(points, i, R, t)
        rx, ry, rz = _turned(points, i, R)
        nx, ny, nz = float(target_normals[j, 0]), float(target_normals[j, 1]), float(target_normals[j, 2])
        depth = float(points[i, 2])
        along = (nx * rx + ny * ry + nz * rz) / depth * sigma[i]
        s = math.sqrt(along * along + float(target_sigma[j]) ** 2 + (_ROUNDING * depth) ** 2)
        distance = nx * (x - target_points[j, 0]) + ny * (y - target_points[j, 1]) + nz * (z - target_points[j, 2])
        spread[i], residual[i] = s, distance / s


@compiled(
    f"void(int64, int64, {_P}, {_P}, {_M}, float64[::1], {_P}, {_P}, {_V}, {_I}, {_V}, {_V}, float64[::1], float64, "
    "float64, float64[:, :, :, ::1], float64[:, ::1])"
)
def accumulate(
    first: int,
    last: int,
    points: F32,
    normals: F32,
    R: F64,
    t: F64,
    target_points: F32,
    target_normals: F32,
    target_sigma: F32,
    index: Any,
    spread: F32,
    residual: F32,
    center: F64,
    length: float,
    cut: float,
    matrices: F64,
    gradients: F64,
) -> None:
    """Sums of the normal equations of the motion (rotation vector * length, translation), of chunks of points.

    A row of the Jacobian is ((p - center) / length x n, n) / spread (Chen and Medioni 1992), with the normal of the
    target, a, or that of the source, b. The weights w are those of Tukey. The point p is the mean of both points with
    the weight of the variance of the other one: its error is independent of that of the distance. That of one of them
    is not, which would turn the pose by as much as its standard deviation.

    Args:
        first, last: chunks of CHUNK points.
        points, normals, R, t: as of :func:`project`.
        target_points, target_normals, target_sigma: as of :func:`measure`.
        index, spread, residual: of :func:`measure`.
        center: float64 (3,), in the frame of the target, m.
        length: m.
        cut: residuals from which on the weight is 0.
        matrices: float64 (chunks, 2, 6, 6), written: sums of w a a^T, and of w' (a b^T + b a^T) / 2, where w' is the
            derivative of w r; upper triangles.
        gradients: float64 (chunks, 6), written: sums of w r a.
    """
    for chunk in range(first, last):
        matrices[chunk] = 0.0
        gradients[chunk] = 0.0
        own, cross, gradient = matrices[chunk, 0], matrices[chunk, 1], gradients[chunk]
        a, b = np.empty(6), np.empty(6)
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, points.shape[0])):
            j = index[i]
            if j < 0:
                continue
            r = float(residual[i])
            u2 = (r / cut) ** 2
            if not u2 < 1.0:
                continue
            w, slope = (1.0 - u2) ** 2, (1.0 - u2) * (1.0 - 5.0 * u2)
            x, y, z = _moved(points, i, R, t)
            share = 1.0 - (target_sigma[j] / spread[i]) ** 2
            x += share * (target_points[j, 0] - x)
            y += share * (target_points[j, 1] - y)
            z += share * (target_points[j, 2] - z)
            x, y, z = (x - center[0]) / length, (y - center[1]) / length, (z - center[2]) / length
            s = 1.0 / spread[i]
            nx, ny, nz = s * target_normals[j, 0], s * target_normals[j, 1], s * target_normals[j, 2]
            mx, my, mz = _turned(normals, i, R)
            mx, my, mz = s * mx, s * my, s * mz
            a[0], a[1], a[2], a[3], a[4], a[5] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx, nx, ny, nz
            b[0], b[1], b[2], b[3], b[4], b[5] = y * mz - z * my, z * mx - x * mz, x * my - y * mx, mx, my, mz
            pull = w * r
            for k in range(6):
                gradient[k] += pull * a[k]
                for m in range(k, 6):
                    own[k, m] += w * a[k] * a[m]
                    cross[k, m] += 0.5 * slope * (a[k] * b[m] + b[k] * a[m])

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels of a volume of signed distances: blocks in a hash table, and the measurements of a range image added to them.

A block has 8 x 8 x 8 grid points, which are numbered x fastest, then y, then z; block (bx, by, bz) begins at grid point
(8 bx, 8 by, 8 bz). The table has open addressing with linear probing (Niessner, Zollhoefer, Izadi and Stamminger,
Real-time 3D reconstruction at scale using voxel hashing, 2013, has blocks of the same size in a table of buckets).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8

__all__ = [
    "BAND",
    "EMPTY",
    "INVERSE",
    "OUTSIDE",
    "REACH",
    "SIDE",
    "SLOPE",
    "SMOOTH",
    "VOXELS",
    "WEIGHT",
    "add_blocks",
    "add_image",
    "find",
    "insert_blocks",
    "key_of",
]

SIDE, VOXELS = 8, 512
EMPTY = -1  # a place of the table without a block
OUTSIDE = -1  # result of add_blocks
_LARGEST = 1 << 20  # of the coordinates of a block
_HASH = np.uint64(0x9E3779B97F4A7C15)
_SHIFT = np.uint64(20)
INVERSE, BAND, SLOPE, REACH, WEIGHT, SMOOTH = range(6)  # values of a pixel
_SLOWEST_COLOR = 1.0 / 16  # share of a new color: 8 bits hold no slower mean

_KEYS, _BLOCKS = "int64[::1]", "int32[::1]"
_F32, _F64, _U8 = "float32[:, ::1]", "float64[::1]", "uint8[:, ::1]"
_MATRIX, _COORDINATES, _NORMALS = "float64[:, ::1]", "int32[:, ::1]", "float32[:, :, ::1]"


@compiled(allocates=False)
def key_of(bx: int, by: int, bz: int) -> int:
    """The coordinates of a block as one number, 0 or above."""
    return ((bx + _LARGEST) << 42) | ((by + _LARGEST) << 21) | (bz + _LARGEST)


@compiled(allocates=False)
def _place(keys: Any, key: int) -> int:
    """Where the key is in the table, or the free place where it belongs."""
    mask = keys.shape[0] - 1
    place = int(np.int64((np.uint64(key) * _HASH) >> _SHIFT)) & mask
    while keys[place] != EMPTY and keys[place] != key:
        place = (place + 1) & mask
    return int(place)


@compiled(allocates=False)
def find(keys: Any, blocks: Any, key: int) -> int:
    """The number of a block; -1 where there is none."""
    place = _place(keys, key)
    return int(blocks[place]) if keys[place] == key else -1


@compiled(f"void({_COORDINATES}, int64, {_KEYS}, {_BLOCKS})")
def insert_blocks(coordinates: Any, count: int, keys: Any, blocks: Any) -> None:
    """Insert the first ``count`` blocks into an empty table.

    Args:
        coordinates: int32 (N, 3).
        count: blocks, at most half of the table.
        keys: int64 (M,), written, a power of two; EMPTY where no block is.
        blocks: int32 (M,), written, the number of each block.
    """
    for block in range(count):
        key = key_of(coordinates[block, 0], coordinates[block, 1], coordinates[block, 2])
        place = _place(keys, key)
        keys[place], blocks[place] = key, block


@compiled(allocates=False)
def _step(position: float, direction: float) -> tuple[float, float]:
    """Along one axis, in blocks: share of the way to the next block, and between two; infinite without motion."""
    if direction > 0.0:
        return (math.floor(position) + 1.0 - position) / direction, 1.0 / direction
    if direction < 0.0:
        return (math.floor(position) - position) / direction, -1.0 / direction
    return math.inf, math.inf


@compiled(
    f"int64(int64, {_F32}, {_NORMALS}, {_F32}, {_F64}, {_F64}, {_MATRIX}, {_F64}, float64, {_KEYS}, {_BLOCKS}, "
    f"{_COORDINATES}, int64[::1])"
)
def add_blocks(
    first: int,
    depth: F32,
    normals: F32,
    band: F32,
    rays_x: F64,
    rays_y: F64,
    rotation: F64,
    translation: F64,
    block_m: float,
    keys: Any,
    blocks: Any,
    coordinates: Any,
    count: Any,
) -> int:
    """Add the blocks that the truncation band of each pixel crosses: from its point along its normal, to both sides.

    Args:
        first: row to begin with.
        depth: float32 (H, W), m.
        normals: float32 (H, W, 3), in the camera.
        band: float32 (H, W), half the width of the band, m; NaN where a pixel does not count.
        rays_x, rays_y: float64 (W,) and (H,), X / Z and Y / Z.
        rotation, translation: float64 (3, 3) and (3,), from the camera to the world, m.
        block_m: side of a block.
        keys, blocks: the table.
        coordinates: int32 (N, 3), written from ``count`` on.
        count: int64 (1,), number of blocks, raised.

    Returns:
        The number of rows when all are done; a smaller row where ``coordinates`` is full, to go on with after it has
        grown; OUTSIDE for a point that no block can have.
    """
    height, width = depth.shape
    q, d = np.empty(3), np.empty(3)
    known = EMPTY
    for y in range(first, height):
        for x in range(width):
            half = float(band[y, x])
            if not half > 0.0:
                continue
            z = float(depth[y, x])
            px, py = rays_x[x] * z, rays_y[y] * z
            nx, ny, nz = float(normals[y, x, 0]), float(normals[y, x, 1]), float(normals[y, x, 2])
            for a in range(3):
                d[a] = 2.0 * half * (rotation[a, 0] * nx + rotation[a, 1] * ny + rotation[a, 2] * nz) / block_m
                center = rotation[a, 0] * px + rotation[a, 1] * py + rotation[a, 2] * z + translation[a]
                q[a] = center / block_m - 0.5 * d[a]
                if not abs(q[a]) < _LARGEST - 64:
                    return OUTSIDE
            bx, by, bz = math.floor(q[0]), math.floor(q[1]), math.floor(q[2])
            (tx, ix), (ty, iy), (tz, iz) = _step(q[0], d[0]), _step(q[1], d[1]), _step(q[2], d[2])
            while True:  # from block to block along the line (Amanatides and Woo 1987)
                key = key_of(bx, by, bz)
                if key != known:
                    place = _place(keys, key)
                    if keys[place] == EMPTY:
                        if count[0] == coordinates.shape[0]:
                            return y
                        keys[place], blocks[place] = key, count[0]
                        coordinates[count[0], 0], coordinates[count[0], 1], coordinates[count[0], 2] = bx, by, bz
                        count[0] += 1
                    known = key
                if min(tx, ty, tz) > 1.0:
                    break
                if tx <= ty and tx <= tz:
                    bx, tx = bx + (1 if d[0] > 0.0 else -1), tx + ix
                elif ty <= tz:
                    by, ty = by + (1 if d[1] > 0.0 else -1), ty + iy
                else:
                    bz, tz = bz + (1 if d[2] > 0.0 else -1), tz + iz
    return int(height)


@compiled(allocates=False)
def _outside(x: float, y: float, z: float, radius: float, rays_x: F64, rays_y: F64) -> bool:
    """Whether a sphere in the camera is outside of what the image shows."""
    if z + radius <= 0.0:
        return True
    left, right, top, bottom = rays_x[0], rays_x[-1], rays_y[0], rays_y[-1]
    margin = 2.0 * (rays_x[-1] - rays_x[0]) / max(rays_x.shape[0] - 1, 1)  # the border pixels reach beyond their rays
    left, right, top, bottom = left - margin, right + margin, top - margin, bottom + margin
    return bool(
        x - left * z < -radius * math.sqrt(1.0 + left * left)
        or x - right * z > radius * math.sqrt(1.0 + right * right)
        or y - top * z < -radius * math.sqrt(1.0 + top * top)
        or y - bottom * z > radius * math.sqrt(1.0 + bottom * bottom)
    )


@compiled(allocates=False)
def _depth_at(pixels: F32, u: float, v: float) -> float:
    """Depth between four joined pixels, of which the first one says so: bilinear in inverse depth, as on a plane."""
    x, y = math.floor(u), math.floor(v)
    a, b = u - x, v - y
    above = (1.0 - a) * pixels[y, x, INVERSE] + a * pixels[y, x + 1, INVERSE]
    below = (1.0 - a) * pixels[y + 1, x, INVERSE] + a * pixels[y + 1, x + 1, INVERSE]
    return float(1.0 / ((1.0 - b) * above + b * below))


@compiled(
    f"void(int64, int64, {_COORDINATES}, float32[:, :, ::1], uint8[:, :, ::1], {_F64}, {_F64}, {_MATRIX}, {_F64}, "
    f"float64, float64, {_F32}, {_F32}, uint8[:, :, ::1], {_MATRIX})",
    allocates=False,
)
def add_image(
    first: int,
    last: int,
    coordinates: Any,
    pixels: F32,
    image_color: U8,
    rays_x: F64,
    rays_y: F64,
    rotation: F64,
    translation: F64,
    voxel_m: float,
    farthest_m: float,
    distance: F32,
    weight: F32,
    color: npt.NDArray[np.uint8],
    apart: F64,
) -> None:
    """Add a range image to the grid points of the blocks ``first`` to ``last - 1`` (Curless and Levoy 1996).

    The distance of a grid point from the surface that its pixel shows is that along the ray times the cosine between
    ray and normal, positive in front. In front of the band it counts as half the width of the band: space that a ray
    has crossed is empty. Behind the surface the weight falls to 0 within the reach of the pixel.

    Args:
        first, last: blocks.
        coordinates: int32 (N, 3), of the blocks.
        pixels: float32 (H, W, 8), values of each pixel: INVERSE, inverse depth, 1 / m; BAND, half the width of the
            band, m, NaN where it does not count; SLOPE, minus the product of normal and ray; REACH, m; WEIGHT, 1 / m^2;
            SMOOTH, 1 where it and those to the right and below are joined.
        image_color: uint8 (H, W, 3).
        rays_x, rays_y: float64 (W,) and (H,), X / Z and Y / Z; equal steps.
        rotation, translation: float64 (3, 3) and (3,), from the camera to the world, m.
        voxel_m: between grid points.
        farthest_m: depth beyond which nothing is changed.
        distance, weight: float32 (N, 512), changed: mean of the distances, and sum of the weights.
        color: uint8 (N, 512, 3), changed.
        apart: float64 (N, 2), written: of grid points in the band that were known before, the sum of the differences
            between new and old distance, in widths of the band, and their number.
    """
    height, width = pixels.shape[:2]
    fx = (width - 1) / (rays_x[-1] - rays_x[0]) if width > 1 else 1.0
    fy = (height - 1) / (rays_y[-1] - rays_y[0]) if height > 1 else 1.0
    radius = 0.5 * (SIDE - 1) * math.sqrt(3.0) * voxel_m
    r = rotation
    for block in range(first, last):
        apart[block, 0] = apart[block, 1] = 0.0
        x0 = SIDE * coordinates[block, 0] * voxel_m - translation[0]
        y0 = SIDE * coordinates[block, 1] * voxel_m - translation[1]
        z0 = SIDE * coordinates[block, 2] * voxel_m - translation[2]
        half = 0.5 * (SIDE - 1) * voxel_m
        cx, cy, cz = x0 + half, y0 + half, z0 + half
        mx = r[0, 0] * cx + r[1, 0] * cy + r[2, 0] * cz
        my = r[0, 1] * cx + r[1, 1] * cy + r[2, 1] * cz
        mz = r[0, 2] * cx + r[1, 2] * cy + r[2, 2] * cz
        if mz - radius > farthest_m or _outside(mx, my, mz, radius, rays_x, rays_y):
            continue
        for voxel in range(VOXELS):
            wx, wy, wz = x0 + (voxel & 7) * voxel_m, y0 + ((voxel >> 3) & 7) * voxel_m, z0 + (voxel >> 6) * voxel_m
            z = r[0, 2] * wx + r[1, 2] * wy + r[2, 2] * wz
            if z <= 1e-6:
                continue
            nearness = 1.0 / z
            u = ((r[0, 0] * wx + r[1, 0] * wy + r[2, 0] * wz) * nearness - rays_x[0]) * fx
            v = ((r[0, 1] * wx + r[1, 1] * wy + r[2, 1] * wz) * nearness - rays_y[0]) * fy
            if not (u >= -0.5 and v >= -0.5 and u < width - 0.5 and v < height - 0.5):
                continue
            px, py = math.floor(u + 0.5), math.floor(v + 0.5)
            wide, slope = float(pixels[py, px, BAND]), float(pixels[py, px, SLOPE])
            if not wide > 0.0:
                continue
            ahead = slope * (1.0 / float(pixels[py, px, INVERSE]) - z)
            close = abs(ahead) < 2.0 * wide and u >= 0.0 and v >= 0.0
            if close and pixels[math.floor(v), math.floor(u), SMOOTH] != 0.0:
                ahead = slope * (_depth_at(pixels, u, v) - z)
            w = float(pixels[py, px, WEIGHT])
            if ahead < 0.0:
                w *= 1.0 + ahead / pixels[py, px, REACH]
                if not w > 0.0:
                    continue
            old, before = float(distance[block, voxel]), float(weight[block, voxel])
            share = w / (before + w)
            if ahead < wide:
                if before > 0.0 and abs(old) < wide:
                    apart[block, 0] += abs(ahead - old) / wide
                    apart[block, 1] += 1.0
                dark = color[block, voxel, 0] == 0 and color[block, voxel, 1] == 0 and color[block, voxel, 2] == 0
                mixed = 1.0 if dark else max(share, _SLOWEST_COLOR)
                for c in range(3):
                    level = float(color[block, voxel, c])
                    color[block, voxel, c] = np.uint8(level + mixed * (float(image_color[py, px, c]) - level) + 0.5)
            else:
                ahead = wide
            distance[block, voxel] = old + share * (ahead - old)
            weight[block, voxel] = before + w

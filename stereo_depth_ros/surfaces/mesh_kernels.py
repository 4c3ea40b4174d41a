# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels of meshes: which pixels are joined, the triangles of each four pixels, and normals."""

from __future__ import annotations

from typing import Any

import numpy as np

from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8

__all__ = [
    "FALLING",
    "FIRST",
    "SECOND",
    "choose_triangles",
    "fill_triangles",
    "fit_lines",
    "fit_planes",
    "join",
    "mesh_normals",
]

# Bits of the triangles of a square of four pixels. The diagonal rises from bottom left to top right, or falls from top
# left to bottom right; the first triangle is the one above it.
FIRST, SECOND, FALLING = 1, 2, 4

_CURVED = 0.5  # share by which steps beside each other differ on a curved surface

_F32, _F64, _U8 = "float32[:, ::1]", "float64[::1]", "uint8[:, ::1]"


@compiled()
def _same_slope(w: F32, v: F32, y: int, x: int, dy: int, dx: int, k2: float) -> bool:
    """Whether the step from (y, x) to (y + dy, x + dx) goes on with the slope of the two steps before it."""
    y2, x2 = y - 2 * dy, x - 2 * dx
    if y2 < 0 or x2 < 0 or y2 >= w.shape[0] or x2 >= w.shape[1]:
        return False
    y1, x1, y0, x0 = y - dy, x - dx, y + dy, x + dx
    step, before, earlier = w[y0, x0] - w[y, x], w[y, x] - w[y1, x1], w[y1, x1] - w[y2, x2]
    slope = 0.5 * (before + earlier)
    if not np.isfinite(slope):
        return False
    bend, kink = abs(step - slope) - _CURVED * abs(slope), abs(before - earlier) - _CURVED * abs(slope)
    of_bend = v[y0, x0] + 2.25 * v[y, x] + 0.25 * v[y2, x2]  # variance of step - slope, and of before - earlier
    of_kink = v[y, x] + 4 * v[y1, x1] + v[y2, x2]
    return bool(max(bend, 0.0) ** 2 <= k2 * of_bend and max(kink, 0.0) ** 2 <= k2 * of_kink)


@compiled()
def _grazing(w: F32, y: int, x: int, dy: int, dx: int, rays_x: F64, rays_y: F64, cos2_min: float) -> bool:
    """Whether the line from a pixel to its neighbor is closer to the line of sight than allowed."""
    z, far = 1.0 / w[y, x], 1.0 / w[y + dy, x + dx]
    rx, ry = 0.5 * (rays_x[x] + rays_x[x + dx]), 0.5 * (rays_y[y] + rays_y[y + dy])
    lx = rays_x[x + dx] * far - rays_x[x] * z
    ly = rays_y[y + dy] * far - rays_y[y] * z
    lz = far - z
    along = lx * rx + ly * ry + lz
    squared = (lx * lx + ly * ly + lz * lz) * (rx * rx + ry * ry + 1.0)
    return bool(squared - along * along < cos2_min * squared)


@compiled()
def _joined(
    w: F32, v: F32, y: int, x: int, dy: int, dx: int, rays_x: F64, rays_y: F64, k2: float, cos2_min: float
) -> bool:
    step = w[y + dy, x + dx] - w[y, x]
    if not np.isfinite(step):
        return False
    if step * step <= k2 * (v[y, x] + v[y + dy, x + dx]):
        return True
    if _grazing(w, y, x, dy, dx, rays_x, rays_y, cos2_min):
        return False
    return _same_slope(w, v, y, x, dy, dx, k2) or _same_slope(w, v, y + dy, x + dx, -dy, -dx, k2)


@compiled(f"void(int64, int64, {_F32}, {_F32}, {_F64}, {_F64}, float64, float64, {_U8}, {_U8})")
def join(
    first: int,
    last: int,
    w: F32,
    v: F32,
    rays_x: F64,
    rays_y: F64,
    k2: float,
    cos2_min: float,
    right: U8,
    down: U8,
) -> None:
    """Whether each pixel is joined with its right and its lower neighbor: 1 or 0.

    Args:
        first, last: rows.
        w: float32 (H, W), inverse depth, NaN where not measured.
        v: float32 (H, W), its variance.
        rays_x, rays_y: float64 (W,) and (H,), X / Z and Y / Z.
        k2: square of the factor of the standard deviation.
        cos2_min: square of the cosine of the largest angle of view.
        right, down: uint8 (H, W), written.
    """
    height, width = w.shape
    for y in range(first, last):
        for x in range(width):
            right[y, x] = x + 1 < width and _joined(w, v, y, x, 0, 1, rays_x, rays_y, k2, cos2_min)
            down[y, x] = y + 1 < height and _joined(w, v, y, x, 1, 0, rays_x, rays_y, k2, cos2_min)


@compiled(f"void(int64, int64, {_F32}, {_U8}, {_U8}, {_U8}, int64[::1])")
def choose_triangles(first: int, last: int, depth: F32, right: U8, down: U8, chosen: U8, counts: Any) -> None:
    """The triangles of each square of four pixels: bits FIRST, SECOND, FALLING; and their number in each row.

    A triangle has two sides that are joined. The diagonal is the one with more triangles, of equal ones the shorter one
    in depth.
    """
    for y in range(first, last):
        total = 0
        for x in range(depth.shape[1] - 1):
            top, bottom, left, far = right[y, x], right[y + 1, x], down[y, x], down[y, x + 1]
            falling = (top and far) + (left and bottom)
            rising = (left and top) + (far and bottom)
            use_falling = falling > rising
            if falling and falling == rising:
                across = abs(depth[y, x] - depth[y + 1, x + 1])
                other = abs(depth[y, x + 1] - depth[y + 1, x])
                use_falling = across < other
            bits = 0
            if use_falling:
                bits = FALLING + FIRST * (top and far) + SECOND * (left and bottom)
            else:
                bits = FIRST * (left and top) + SECOND * (far and bottom)
            chosen[y, x] = bits
            total += max(falling, rising)
        counts[y] = total


@compiled(f"void(int64, int64, {_U8}, int64[::1], int32[:, ::1], int32[:, ::1])")
def fill_triangles(first: int, last: int, chosen: U8, starts: Any, numbers: Any, triangles: Any) -> None:
    """The vertices of each triangle, counter-clockwise seen from the camera.

    Args:
        first, last: rows of the squares.
        chosen: of :func:`choose_triangles`.
        starts: int64 (H - 1,), the first triangle of each row.
        numbers: int32 (H, W), the vertex of each pixel.
        triangles: int32 (M, 3), written.
    """
    for y in range(first, last):
        n = starts[y]
        for x in range(chosen.shape[1]):
            bits = chosen[y, x]
            a, b, c, d = numbers[y, x], numbers[y, x + 1], numbers[y + 1, x], numbers[y + 1, x + 1]
            if bits & FIRST:
                triangles[n, 0] = a
                triangles[n, 1] = d if bits & FALLING else c
                triangles[n, 2] = b
                n += 1
            if bits & SECOND:
                triangles[n, 0] = a if bits & FALLING else b
                triangles[n, 1] = c
                triangles[n, 2] = d
                n += 1


@compiled()
def _add_normal(
    depth: F32,
    rays_x: F64,
    rays_y: F64,
    ay: int,
    ax: int,
    by: int,
    bx: int,
    cy: int,
    cx: int,
    total: F64,
) -> None:
    """Add (b - a) x (c - a), which is twice the area long and points to the camera."""
    za, zb, zc = float(depth[ay, ax]), float(depth[by, bx]), float(depth[cy, cx])
    px, py, pz = rays_x[bx] * zb - rays_x[ax] * za, rays_y[by] * zb - rays_y[ay] * za, zb - za
    qx, qy, qz = rays_x[cx] * zc - rays_x[ax] * za, rays_y[cy] * zc - rays_y[ay] * za, zc - za
    total[0] += py * qz - pz * qy
    total[1] += pz * qx - px * qz
    total[2] += px * qy - py * qx


@compiled(f"void(int64, int64, {_F32}, {_F64}, {_F64}, {_U8}, float32[:, :, ::1])")
def mesh_normals(first: int, last: int, depth: F32, rays_x: F64, rays_y: F64, chosen: U8, normals: F32) -> None:
    """The unit normal of each pixel: mean of its triangles, weighted by their area; NaN without one.

    Args:
        first, last: rows.
        depth: float32 (H, W), m.
        rays_x, rays_y: float64 (W,) and (H,), X / Z and Y / Z.
        chosen: of :func:`choose_triangles`.
        normals: float32 (H, W, 3), written.
    """
    height, width = depth.shape
    total = np.empty(3)
    for y in range(first, last):
        for x in range(width):
            total[:] = 0.0
            for sy in range(max(y - 1, 0), min(y, height - 2) + 1):
                for sx in range(max(x - 1, 0), min(x, width - 2) + 1):
                    bits = chosen[sy, sx]
                    falling = (bits & FALLING) != 0
                    # 0 top left, 1 top right, 2 bottom left, 3 bottom right
                    corner = 2 * (y - sy) + (x - sx)
                    if bits & FIRST and corner != (2 if falling else 3):
                        by, bx = sy + 1, sx + 1 if falling else sx
                        _add_normal(depth, rays_x, rays_y, sy, sx, by, bx, sy, sx + 1, total)
                    if bits & SECOND and corner != (1 if falling else 0):
                        ax = sx if falling else sx + 1
                        _add_normal(depth, rays_x, rays_y, sy, ax, sy + 1, sx, sy + 1, sx + 1, total)
            length = np.sqrt(total[0] * total[0] + total[1] * total[1] + total[2] * total[2])
            for i in range(3):
                normals[y, x, i] = total[i] / length if length > 0 else np.nan


@compiled()
def _spread(right: U8, down: U8, y: int, x: int, radius: int, reached: U8) -> None:
    """Mark the pixels of the window that are joined with its center, by pixels of the window."""
    height, width = right.shape
    reached[:, :] = 0
    reached[radius, radius] = 1
    changed = True
    while changed:
        changed = False
        for j in range(max(0, radius - y), min(2 * radius + 1, height + radius - y)):
            for i in range(max(0, radius - x), min(2 * radius + 1, width + radius - x)):
                v, u = y + j - radius, x + i - radius
                if i < 2 * radius and right[v, u] and reached[j, i] != reached[j, i + 1]:
                    reached[j, i] = 1
                    reached[j, i + 1] = 1
                    changed = True
                if j < 2 * radius and down[v, u] and reached[j, i] != reached[j + 1, i]:
                    reached[j, i] = 1
                    reached[j + 1, i] = 1
                    changed = True


@compiled(f"void(int64, int64, {_F32}, {_F64}, {_F64}, {_U8}, {_U8}, int64, float32[:, :, ::1])")
def fit_planes(
    first: int, last: int, w: F32, rays_x: F64, rays_y: F64, right: U8, down: U8, radius: int, normals: F32
) -> None:
    """The unit normal of each pixel: that of the plane through the pixels of a window that are joined with it.

    On a plane n X = h, inverse depth is linear in the rays: w = (n / h) (x, y, 1). It is fitted by least squares.

    Args:
        first, last: rows.
        w: float32 (H, W), inverse depth, NaN where not measured.
        rays_x, rays_y: float64 (W,) and (H,), X / Z and Y / Z.
        right, down: of :func:`join`.
        radius: of the window, px.
        normals: float32 (H, W, 3), written; NaN without three pixels that are not in a line.
    """
    reached = np.empty((2 * radius + 1, 2 * radius + 1), np.uint8)
    for y in range(first, last):
        for x in range(w.shape[1]):
            normals[y, x, :] = np.nan
            if not np.isfinite(w[y, x]):
                continue
            _spread(right, down, y, x, radius, reached)
            n = sx = sy = sw = sxx = sxy = syy = sxw = syw = 0.0
            for j in range(2 * radius + 1):
                for i in range(2 * radius + 1):
                    if reached[j, i]:
                        v, u = y + j - radius, x + i - radius
                        dx, dy, dw = rays_x[u] - rays_x[x], rays_y[v] - rays_y[y], float(w[v, u]) - float(w[y, x])
                        n, sx, sy, sw = n + 1, sx + dx, sy + dy, sw + dw
                        sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
                        sxw, syw = sxw + dx * dw, syw + dy * dw
            sxx, sxy, syy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
            sxw, syw = sxw - sx * sw / n, syw - sy * sw / n
            det = sxx * syy - sxy * sxy
            if not det > 1e-9 * sxx * syy:
                continue
            a, b = (syy * sxw - sxy * syw) / det, (sxx * syw - sxy * sxw) / det
            level = float(w[y, x]) + (sw - a * sx - b * sy) / n
            c = level - a * rays_x[x] - b * rays_y[y]
            scale = -1.0 / np.sqrt(a * a + b * b + c * c)
            normals[y, x, 0], normals[y, x, 1], normals[y, x, 2] = a * scale, b * scale, c * scale


@compiled()
def _line_slope(w: F32, rays: F64, joined: U8, y: int, x: int, dy: int, dx: int, radius: int) -> tuple[float, float]:
    """Slope of w over a ray coordinate, and w at (y, x), along the pixels of a row or column that are joined; or NaN.

    By least squares over up to ``radius`` pixels on both sides.
    """
    at, n, s, sw, ss, ssw = (y if dy else x), 1.0, 0.0, 0.0, 0.0, 0.0
    center = float(w[y, x])
    for sign in (-1, 1):
        j, i = y, x
        for _ in range(radius):
            before_j, before_i = (j, i) if sign > 0 else (j - dy, i - dx)
            if before_j < 0 or before_i < 0 or not joined[before_j, before_i]:
                break
            j, i = j + sign * dy, i + sign * dx
            d, value = rays[j if dy else i] - rays[at], float(w[j, i]) - center
            n, s, sw, ss, ssw = n + 1.0, s + d, sw + value, ss + d * d, ssw + d * value
    if n < 2.0:
        return np.nan, np.nan
    slope = (ssw - s * sw / n) / (ss - s * s / n)
    return slope, center + (sw - slope * s) / n


@compiled(f"void(int64, int64, {_F32}, {_F64}, {_F64}, {_U8}, {_U8}, int64, float32[:, :, ::1])")
def fit_lines(
    first: int, last: int, w: F32, rays_x: F64, rays_y: F64, right: U8, down: U8, radius: int, normals: F32
) -> None:
    """The unit normal of each pixel by two lines of joined pixels, its row and its column; faster than windows.

    Args:
        first, last: rows.
        w: float32 (H, W), inverse depth, NaN where not measured.
        rays_x, rays_y: float64 (W,) and (H,), X / Z and Y / Z.
        right, down: of :func:`join`.
        radius: pixels on each side.
        normals: float32 (H, W, 3), written; NaN without a neighbor in the row and one in the column.
    """
    for y in range(first, last):
        for x in range(w.shape[1]):
            normals[y, x, :] = np.nan
            if not np.isfinite(w[y, x]):
                continue
            a, of_row = _line_slope(w, rays_x, right, y, x, 0, 1, radius)
            b, of_column = _line_slope(w, rays_y, down, y, x, 1, 0, radius)
            c = 0.5 * (of_row + of_column) - a * rays_x[x] - b * rays_y[y]
            scale = -1.0 / np.sqrt(a * a + b * b + c * c)
            normals[y, x, 0], normals[y, x, 1], normals[y, x, 2] = a * scale, b * scale, c * scale

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ray casting kernels: visible surface, depth, gray level and shadow of each pixel.

They use only +, -, *, /, square root, floor and integer arithmetic, all correctly rounded and without fast-math: equal
inputs give equal bytes on every machine that follows IEEE 754.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.synthetic.scene import RECTANGLE, Vector

__all__ = ["depth_and_shadow", "in_shadow", "pixel_rays", "rays_of", "render", "trace"]

SUPERSAMPLING = 2  # rays per pixel and axis

_NEAREST_M = 1e-6
_SAME_POINT = 1.0 - 1e-9  # a surface before this fraction of a line of sight occludes the point at its end
_BACKGROUND = 20.0
_FINEST_CELL_M = 0.012
_OCTAVES = 5
_C1, _C2, _C3 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F), np.uint64(0x165667B19E3779F9)
_C4, _C5 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S30, _S40 = np.uint64(30), np.uint64(40)

_FLOATS, _MATRIX = "float64[::1]", "float64[:, ::1]"


@compiled()
def _lattice(a: int, b: int, c: int, key: int) -> float:
    """Pseudo-random value in [-1, 1) of a lattice point, from the upper bits of a multiplicative hash."""
    h = (np.uint64(a) * _C1) ^ (np.uint64(b) * _C2) ^ (np.uint64(c) * _C3) ^ (np.uint64(key) * _C5)
    return float(np.int64(((h ^ (h >> _S30)) * _C4) >> _S40) / 8388608.0 - 1.0)


@compiled()
def _value_noise(x: float, y: float, z: float, key: int) -> float:
    """Value noise in [-1, 1] on a unit lattice, with the cubic interpolation of Perlin 1985."""
    a, b, c = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = x - a, y - b, z - c
    u, v, w = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v), w * w * (3.0 - 2.0 * w)
    total = 0.0
    for k in range(2):
        for j in range(2):
            low, high = _lattice(a, b + j, c + k, key), _lattice(a + 1, b + j, c + k, key)
            total += (v if j else 1.0 - v) * (w if k else 1.0 - w) * (low + u * (high - low))
    return total


@compiled()
def _octaves(p: Vector, footprint_m: float, key: int) -> float:
    """Sum of noise at several scales; scales below the resolution of a pixel of ``footprint_m`` fade out."""
    total, power, per_m = 0.0, 0.0, 1.0 / _FINEST_CELL_M
    for octave in range(_OCTAVES):
        weight = min(1.0 / (per_m * footprint_m) - 1.5, 1.0)
        if weight > 0.0:
            total += weight * _value_noise(p[0] * per_m, p[1] * per_m, p[2] * per_m, key + octave)
            power += weight * weight
        per_m *= 0.5
    return total / math.sqrt(power) if power > 0.0 else 0.0


@compiled()
def _wave(x: float) -> float:
    """A smooth periodic function with period 1 and values in [-1, 1], without trigonometry."""
    t = abs(2.0 * (x - math.floor(x)) - 1.0)
    return 2.0 * t * t * (3.0 - 2.0 * t) - 1.0


@compiled()
def _hit(row: F64, o: Vector, d: Vector, best: float) -> float:
    """Smallest t with o + t d on the primitive ``row``; ``best`` where there is none below it."""
    x, y, z = o[0] - row[1], o[1] - row[2], o[2] - row[3]
    if row[0] == RECTANGLE:
        slope = row[10] * d[0] + row[11] * d[1] + row[12] * d[2]
        if slope == 0.0:
            return best
        t = -(row[10] * x + row[11] * y + row[12] * z) / slope
        if not _NEAREST_M < t < best:
            return best
        x, y, z = x + t * d[0], y + t * d[1], z + t * d[2]
        v = row[7] * x + row[8] * y + row[9] * z
        if not 0.0 <= v <= 1.0:
            return best
    else:
        along_d = row[10] * d[0] + row[11] * d[1] + row[12] * d[2]  # 0 for a sphere, whose axis is zero
        along_o = row[10] * x + row[11] * y + row[12] * z
        ex, ey, ez = d[0] - along_d * row[10], d[1] - along_d * row[11], d[2] - along_d * row[12]
        fx, fy, fz = x - along_o * row[10], y - along_o * row[11], z - along_o * row[12]
        a, b = ex * ex + ey * ey + ez * ez, ex * fx + ey * fy + ez * fz
        root = b * b - a * (fx * fx + fy * fy + fz * fz - row[13] * row[13])
        if root < 0.0 or a == 0.0:
            return best
        t = (-b - math.sqrt(root)) / a
        if not _NEAREST_M < t < best:
            return best
        x, y, z = x + t * d[0], y + t * d[1], z + t * d[2]
    u = row[4] * x + row[5] * y + row[6] * z
    return t if 0.0 <= u <= 1.0 else best


@compiled()
def _nearest(primitives: F64, o: Vector, d: Vector) -> tuple[float, int]:
    """(t, index) of the first surface along the ray o + t d; (inf, -1) where there is none."""
    best, index = math.inf, -1
    for i in range(primitives.shape[0]):
        t = _hit(primitives[i], o, d, best)
        if t < best:
            best, index = t, i
    return best, index


@compiled()
def _rotated(rotation: F64, x: float, y: float) -> Vector:
    """rotation @ (x, y, 1)."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2],
    )


@compiled()
def _level(primitives: F64, o: Vector, d: Vector, pixel_rad: float, seed: int) -> float:
    """Gray level seen along the ray o + t d, where t is the depth along the optical axis."""
    t, index = _nearest(primitives, o, d)
    if index < 0:
        return _BACKGROUND
    p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    return _texture(primitives, index, p, t * pixel_rad, seed)


@compiled()
def _texture(primitives: F64, index: int, p: Vector, footprint_m: float, seed: int) -> float:
    """Gray level of a point of a surface, seen with pixels of ``footprint_m``."""
    mean, contrast = float(primitives[index, 14]), float(primitives[index, 15])
    period_m = float(primitives[index, 16])
    if period_m > 0.0:
        return mean + contrast * _wave(p[0] / period_m) * _wave(p[1] / period_m)
    return mean + contrast * _octaves(p, footprint_m, seed * 4096 + index * 16)


@compiled(
    f"void(int64, int64, {_MATRIX}, {_FLOATS}, {_MATRIX}, float64[:, :, ::1], float64, float64, float64, int64, int64, "
    "uint8[:, ::1])"
)
def render(
    first: int,
    last: int,
    primitives: F64,
    origin: F64,
    rotation: F64,
    rays: F64,
    pixel_rad: float,
    gain: float,
    noise: float,
    texture_seed: int,
    noise_seed: int,
    image: U8,
) -> None:
    """Renders the rows ``first`` to ``last - 1`` of the raw image of a camera.

    Args:
        first, last: range of rows.
        primitives: float64 (N, 17), of :meth:`Scene.packed`.
        origin: float64 (3,), the camera center in the world, meters.
        rotation: float64 (3, 3), camera to world.
        rays: float64 (2H, 2W, 2), of :func:`pixel_rays`.
        pixel_rad: angle of one pixel, radians; textures have no detail below it.
        gain: factor of all gray levels.
        noise: largest value of the sensor noise (triangular distribution), gray levels.
        texture_seed, noise_seed: seeds of the textures and of the sensor noise.
        image: uint8 (H, W), output.
    """
    n, o = SUPERSAMPLING, (origin[0], origin[1], origin[2])
    for y in range(first, last):
        for x in range(image.shape[1]):
            total = 0.0
            for row in range(n * y, n * y + n):
                for col in range(n * x, n * x + n):
                    d = _rotated(rotation, rays[row, col, 0], rays[row, col, 1])
                    total += _level(primitives, o, d, pixel_rad, texture_seed)
            even = 0.5 * (_lattice(x, y, 0, noise_seed) - _lattice(x, y, 1, noise_seed))
            image[y, x] = min(max(math.floor(gain * total / (n * n) + noise * even + 0.5), 0.0), 255.0)


@compiled(f"void(int64, int64, {_MATRIX}, {_FLOATS}, {_MATRIX}, {_MATRIX}, {_FLOATS}, {_MATRIX}, boolean[:, ::1])")
def depth_and_shadow(
    first: int,
    last: int,
    primitives: F64,
    origin: F64,
    rotation: F64,
    P: F64,
    other: F64,
    depth_m: F64,
    shadow: npt.NDArray[np.bool_],
) -> None:
    """Exact depth of the pixels of a rectified camera, and which of their points are occluded in another camera.

    Args:
        first, last: range of rows, ``last`` excluded.
        primitives: float64 (N, 17), of :meth:`Scene.packed`.
        origin: float64 (3,), the camera center in the world, meters.
        rotation: float64 (3, 3), rectified camera to world.
        P: float64 (3, 4), projection matrix of the camera; the rays pass through the pixel centers.
        other: float64 (3,), center of the other camera in the world, meters.
        depth_m: float64 (H, W), output: depth along the optical axis, meters; NaN without a surface.
        shadow: bool (H, W), output: true where a surface is between the point and the other camera.
    """
    o, c = (origin[0], origin[1], origin[2]), (other[0], other[1], other[2])
    for y in range(first, last):
        for x in range(depth_m.shape[1]):
            d = _rotated(rotation, (x - P[0, 2]) / P[0, 0], (y - P[1, 2]) / P[1, 1])
            t, index = _nearest(primitives, o, d)
            if index < 0:
                depth_m[y, x], shadow[y, x] = np.nan, False
            else:
                sight = (o[0] + t * d[0] - c[0], o[1] + t * d[1] - c[1], o[2] + t * d[2] - c[2])
                depth_m[y, x] = t
                shadow[y, x] = _nearest(primitives, c, sight)[0] < _SAME_POINT


@compiled(
    f"void(int64, int64, {_MATRIX}, {_FLOATS}, {_MATRIX}, float64[:, :, ::1], float64, int64, float64[:, :, ::1], "
    f"float64[:, :, ::1], {_MATRIX}, int32[:, ::1])"
)
def trace(
    first: int,
    last: int,
    primitives: F64,
    origin: F64,
    rotation: F64,
    rays: F64,
    pixel_rad: float,
    seed: int,
    points: F64,
    normals: F64,
    levels: F64,
    surface: npt.NDArray[np.int32],
) -> None:
    """Where rays meet the scene: points, normals and textures.

    Args:
        first, last: range of rows of ``rays``, ``last`` excluded.
        primitives: float64 (N, 17), of :meth:`Scene.packed`.
        origin: float64 (3,), where the rays begin in the world, meters.
        rotation: float64 (3, 3), from the axes of the rays to the world.
        rays: float64 (H, W, 2): x / z and y / z.
        pixel_rad: angle of one pixel, radians; textures have no detail below it.
        seed: of the textures.
        points: float64 (H, W, 3), output: in the world, meters; NaN without a surface.
        normals: float64 (H, W, 3), output: unit vectors towards the origin of the rays; NaN without a surface.
        levels: float64 (H, W), output: gray levels of the textures; 0 without a surface.
        surface: int32 (H, W), output: index of the primitive; -1 without a surface.
    """
    o = (origin[0], origin[1], origin[2])
    for y in range(first, last):
        for x in range(rays.shape[1]):
            d = _rotated(rotation, rays[y, x, 0], rays[y, x, 1])
            t, index = _nearest(primitives, o, d)
            surface[y, x], levels[y, x] = index, 0.0
            points[y, x], normals[y, x] = np.nan, np.nan
            if index >= 0:
                p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
                n = _normal(primitives[index], p)
                towards = -1.0 if n[0] * d[0] + n[1] * d[1] + n[2] * d[2] > 0.0 else 1.0
                for k in range(3):
                    points[y, x, k], normals[y, x, k] = p[k], towards * n[k]
                levels[y, x] = _texture(primitives, index, p, t * pixel_rad, seed)


@compiled()
def _normal(row: F64, p: Vector) -> Vector:
    """Unit normal of the primitive ``row`` in its point ``p``."""
    x, y, z = p[0] - row[1], p[1] - row[2], p[2] - row[3]
    if row[0] == RECTANGLE:
        x, y, z = row[10], row[11], row[12]
    else:
        along = row[10] * x + row[11] * y + row[12] * z  # 0 for a sphere, whose axis is zero
        x, y, z = x - along * row[10], y - along * row[11], z - along * row[12]
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@compiled(f"void(int64, int64, {_MATRIX}, float64[:, :, ::1], {_FLOATS}, boolean[:, ::1])")
def in_shadow(first: int, last: int, primitives: F64, points: F64, light: F64, shadow: npt.NDArray[np.bool_]) -> None:
    """Which points a light does not reach.

    Args:
        first, last: range of rows, ``last`` excluded.
        primitives: float64 (N, 17), of :meth:`Scene.packed`.
        points: float64 (H, W, 3), of :func:`trace`, meters.
        light: float64 (3,), its position in the world, meters.
        shadow: bool (H, W), output: true where a surface is between the point and the light, or there is no point.
    """
    c = (light[0], light[1], light[2])
    for y in range(first, last):
        for x in range(points.shape[1]):
            sight = (points[y, x, 0] - c[0], points[y, x, 1] - c[1], points[y, x, 2] - c[2])
            shadow[y, x] = not _nearest(primitives, c, sight)[0] >= _SAME_POINT or math.isnan(sight[0])


def rays_of(camera: CameraModel) -> F64:
    """The 2 x 2 rays through every raw pixel of a plumb_bob camera, float64 (2H, 2W, 2), see :func:`pixel_rays`."""
    rays = np.empty((SUPERSAMPLING * camera.height, SUPERSAMPLING * camera.width, 2))
    run_bands(pixel_rays, len(rays), camera.K, camera.D, rays)
    return rays


@compiled(f"void(int64, int64, {_MATRIX}, {_FLOATS}, float64[:, :, ::1])")
def pixel_rays(first: int, last: int, K: F64, D: F64, rays: F64) -> None:
    """Directions of 2 x 2 rays through every raw pixel of a plumb_bob camera, by fixed-point iteration.

    Args:
        first, last: range of rows of ``rays``, ``last`` excluded.
        K: float64 (3, 3), camera matrix, pixels.
        D: float64 (5,), distortion coefficients k1 k2 p1 p2 k3.
        rays: float64 (2H, 2W, 2), output: x / z and y / z of the rays, which are a quarter of a pixel from the pixel
            center in x and y.
    """
    n = SUPERSAMPLING
    for row in range(first, last):
        yd = ((row + 0.5) / n - 0.5 - K[1, 2]) / K[1, 1]
        for col in range(rays.shape[1]):
            xd = ((col + 0.5) / n - 0.5 - K[0, 2]) / K[0, 0]
            x, y = xd, yd
            for _ in range(50):  # each step reduces the error by a factor of 3 in the corners, and by more inside
                before = (x, y)
                r2 = x * x + y * y
                radial = 1.0 + r2 * (D[0] + r2 * (D[1] + r2 * D[4]))
                dx = 2.0 * D[2] * x * y + D[3] * (r2 + 2.0 * x * x)
                dy = D[2] * (r2 + 2.0 * y * y) + 2.0 * D[3] * x * y
                x, y = (xd - dx) / radial, (yd - dy) / radial
                if (x, y) == before:
                    break
            rays[row, col, 0], rays[row, col, 1] = x, y

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Range images of shapes in closed form, from cameras all around them, for tests of fused surfaces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.surfaces.mesh import Mesh
from stereo_depth_ros.surfaces.range_image import RangeImage

WIDTH, HEIGHT = 120, 100
GEOMETRY = Triangulation(136.0, 130.0, 57.5, 51.0, 0.12, 3.5)
Depth = Callable[[F64, F64], F64]  # origin (3,) and rays (H, W, 3) in the world to t of each ray, NaN beside the shape


def looking_at(place: Any, target: Any) -> Pose:
    """The pose of a camera, rolled a little, in the world."""
    z = np.subtract(target, place).astype(float)
    z /= np.linalg.norm(z)
    x = np.cross([0.1, 0.9, 0.3] if abs(z[1]) < 0.8 else [1.0, 0.1, 0.2], z)
    x /= np.linalg.norm(x)
    return Pose(np.stack((x, np.cross(z, x), z), axis=1), np.array(place, float))


def view(shape: Depth, pose: Pose, sigma_m: float = 0.0, seed: int | None = None) -> RangeImage:
    """What a camera sees of a shape, with noise where there is a seed; the color is that of the pixel."""
    y, x = np.indices((HEIGHT, WIDTH))
    g = GEOMETRY
    rays = np.stack(((x - g.cx_px) / g.f_px, (y - g.cy_px) / g.fy_px, np.ones(x.shape)), axis=2)
    depth = shape(pose.translation_m, rays @ pose.rotation.T)
    if seed is not None:
        depth = depth + np.random.default_rng(seed).normal(0, sigma_m, depth.shape)
    color = np.stack((40 + x, 60 + y, np.full(x.shape, 90)), axis=2).astype(np.uint8)
    sigma = np.full(depth.shape, sigma_m, np.float32)
    return RangeImage(depth.astype(np.float32), sigma, GEOMETRY, color)


def ball(center: Any, radius_m: float) -> Depth:
    """A sphere."""

    def depth(origin: F64, rays: F64) -> F64:
        o = origin - np.array(center)
        a, b = np.sum(rays * rays, axis=2), rays @ o
        with np.errstate(invalid="ignore"):
            return np.asarray((-b - np.sqrt(b * b - a * (o @ o - radius_m**2))) / a)

    return depth


def box(low: Any, high: Any) -> Depth:
    """A box with the axes of the world."""

    def depth(origin: F64, rays: F64) -> F64:
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = (np.array(low) - origin) / rays, (np.array(high) - origin) / rays
        into, out = np.minimum(one, other).max(axis=2), np.maximum(one, other).min(axis=2)
        return np.where((into < out) & (into > 0), into, np.nan)

    return depth


def plane(axis: int, at_m: float) -> Depth:
    """A plane perpendicular to an axis."""

    def depth(origin: F64, rays: F64) -> F64:
        with np.errstate(divide="ignore"):
            t = (at_m - origin[axis]) / rays[..., axis]
        return np.where(t > 0, t, np.nan)

    return depth


def nearest(*shapes: Depth) -> Depth:
    """Several shapes."""

    def depth(origin: F64, rays: F64) -> F64:
        found = np.full(rays.shape[:2], np.nan)
        for shape in shapes:
            found = np.fmin(found, shape(origin, rays))
        return found

    return depth


def around(target: Any, distance_m: float) -> list[Pose]:
    """Cameras on the corners and the faces of a cube around a target."""
    directions = [np.array(d, float) for d in np.ndindex(3, 3, 3) if np.count_nonzero(np.array(d) - 1) in (1, 3)]
    return [looking_at(np.array(target) + distance_m * (d - 1) / np.linalg.norm(d - 1), target) for d in directions]


def edge_uses(mesh: Mesh) -> tuple[set[int], bool, int]:
    """How often edges are used by triangles, whether the two uses have opposite directions, and number of edges."""
    edges = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    keys, counts = np.unique((edges.min(axis=1) << 32) | edges.max(axis=1), return_counts=True)
    directed = np.unique((edges[:, 0] << 32) | edges[:, 1])
    return {*counts.tolist()}, len(directed) == len(edges), len(keys)


def euler(mesh: Mesh) -> int:
    """Vertices - edges + triangles."""
    return len(mesh.points_m) - edge_uses(mesh)[2] + len(mesh.triangles)


def area_and_volume(mesh: Mesh) -> tuple[float, float]:
    """Of a closed mesh; the volume is above 0 where its triangles are counter-clockwise seen from outside."""
    a, b, c = (mesh.points_m[mesh.triangles[:, i]].astype(np.float64) for i in range(3))
    cross = np.cross(b - a, c - a)
    return float(np.linalg.norm(cross, axis=1).sum() / 2), float(np.sum(a * cross) / 6)

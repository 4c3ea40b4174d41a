# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The synthetic scene: rectangles, spheres and cylinders with solid textures, in meters.

The world has the axes of an optical frame: x right, y down, z forward. A solid texture assigns a gray level to every
point in space, so that surfaces need no texture coordinates and both cameras see the same level at the same point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from stereo_depth_ros.core.types import F64

__all__ = ["Cylinder", "Primitive", "Rectangle", "Scene", "Sphere", "Texture", "Vector", "room_scene"]

Vector: TypeAlias = tuple[float, float, float]

RECTANGLE, SPHERE, CYLINDER = 0.0, 1.0, 2.0


@dataclass(frozen=True)
class Texture:
    """A solid texture: noise, or a grid that repeats every ``period_m`` in world x and y.

    Attributes:
        mean: mean gray level, 0..255.
        contrast: amplitude of the variation, gray levels.
        period_m: period of the grid, meters; 0 is noise without repetition.
    """

    mean: float = 120.0
    contrast: float = 75.0
    period_m: float = 0.0


@dataclass(frozen=True)
class Rectangle:
    """A planar rectangle, given by one corner and two perpendicular edges in meters; visible from both sides."""

    corner: Vector
    edge_u: Vector
    edge_v: Vector
    texture: Texture = Texture()

    def distances(self, points_m: F64) -> F64:
        """Distances of points from the surface, as :meth:`Scene.distances`."""
        u, v, p = np.array(self.edge_u), np.array(self.edge_v), points_m - np.array(self.corner)
        a, b = np.clip(p @ u / _squared(u), 0, 1), np.clip(p @ v / _squared(v), 0, 1)
        return np.asarray(np.linalg.norm(p - a[:, None] * u - b[:, None] * v, axis=1), np.float64)

    def packed(self) -> F64:
        """The primitive as a row of :meth:`Scene.packed`, float64 (17,)."""
        u, v = np.array(self.edge_u), np.array(self.edge_v)
        normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        return _row(RECTANGLE, self.corner, self.texture, u / _squared(u), v / _squared(v), normal)


@dataclass(frozen=True)
class Sphere:
    """A sphere; visible from outside."""

    center: Vector
    radius_m: float
    texture: Texture = Texture()

    def distances(self, points_m: F64) -> F64:
        """Distances of points from the surface, as :meth:`Scene.distances`."""
        off = np.linalg.norm(points_m - np.array(self.center), axis=1) - self.radius_m
        return np.asarray(np.abs(off), np.float64)

    def packed(self) -> F64:
        """The primitive as a row of :meth:`Scene.packed`, float64 (17,)."""
        zero = (0.0, 0.0, 0.0)
        return _row(SPHERE, self.center, self.texture, zero, zero, zero, self.radius_m)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder from ``base`` to ``base + axis``; visible from outside, with open ends."""

    base: Vector
    axis: Vector
    radius_m: float
    texture: Texture = Texture()

    def distances(self, points_m: F64) -> F64:
        """Distances of points from the surface, as :meth:`Scene.distances`."""
        axis, p = np.array(self.axis), points_m - np.array(self.base)
        along = np.clip(p @ axis / _squared(axis), 0, 1)
        return np.asarray(np.abs(np.linalg.norm(p - along[:, None] * axis, axis=1) - self.radius_m), np.float64)

    def packed(self) -> F64:
        """The primitive as a row of :meth:`Scene.packed`, float64 (17,)."""
        axis = np.array(self.axis)
        unit = axis / np.sqrt(_squared(axis))
        return _row(CYLINDER, self.base, self.texture, axis / _squared(axis), (0.0, 0.0, 0.0), unit, self.radius_m)


Primitive: TypeAlias = Rectangle | Sphere | Cylinder


@dataclass(frozen=True)
class Scene:
    """Surfaces and the seed of their textures.

    Attributes:
        primitives: the surfaces; of two that coincide the first one is visible.
        seed: seed of the textures; the shapes do not depend on it.
    """

    primitives: tuple[Primitive, ...]
    seed: int

    def packed(self) -> F64:
        """The primitives for the ray casting kernels, float64 (N, 17), one row each."""
        return np.stack([primitive.packed() for primitive in self.primitives])

    def distances(self, points_m: F64) -> F64:
        """Distance of each point, float64 (N, 3), from the nearest surface, float64 (N,), meters."""
        return np.asarray(np.min([primitive.distances(points_m) for primitive in self.primitives], axis=0), np.float64)


def room_scene(seed: int) -> Scene:
    """A room of 5.2 x 2.6 x 8.2 m with objects, for a camera near the origin; the nearest object is 1.6 m ahead."""
    return Scene((*_walls(), *_boards(), *_spheres(), *_cylinders()), seed)


def _walls() -> list[Primitive]:
    left, right, top, floor, near, far = -2.6, 2.6, -1.5, 1.1, -1.0, 7.2
    across, down, along = (right - left, 0.0, 0.0), (0.0, floor - top, 0.0), (0.0, 0.0, far - near)
    return [
        Rectangle((left, floor, near), across, along, Texture(105.0, 70.0)),
        Rectangle((left, top, near), across, along, Texture(165.0, 60.0)),
        Rectangle((left, top, near), along, down, Texture(130.0)),
        Rectangle((right, top, near), along, down, Texture(110.0)),
        Rectangle((left, top, far), across, down, Texture(140.0)),
        Rectangle((-0.4, -1.3, far - 0.03), (2.2, 0.0, 0.0), (0.0, 1.7, 0.0), Texture(125.0, 65.0, period_m=0.28)),
    ]


def _boards() -> list[Primitive]:
    return [
        Rectangle((-1.75, -0.75, 3.0), (0.96, 0.0, 0.72), (0.0, 1.1, 0.0), Texture(150.0)),
        Rectangle((0.75, 1.1, 2.9), (1.3, 0.0, 0.0), (0.0, -0.7, 1.0), Texture(95.0)),
        Rectangle((0.62, -0.1, 1.9), (0.45, 0.0, 0.0), (0.0, 0.38, 0.06), Texture(135.0)),
    ]


def _spheres() -> list[Primitive]:
    return [
        Sphere((0.05, 0.75, 2.7), 0.35, Texture(160.0)),
        Sphere((-1.3, 0.6, 4.4), 0.5, Texture(85.0)),
        Sphere((0.3, -0.45, 2.2), 0.17, Texture(120.0)),
    ]


def _cylinders() -> list[Primitive]:
    return [
        Cylinder((-0.5, -1.5, 1.75), (0.0, 2.6, 0.0), 0.018, Texture(175.0, 50.0)),
        Cylinder((1.0, -1.5, 2.6), (0.35, 2.6, 0.2), 0.03, Texture(75.0, 60.0)),
        Cylinder((-0.15, -1.5, 4.8), (0.0, 2.6, 0.0), 0.05, Texture(70.0, 60.0)),
    ]


def _squared(vector: F64) -> float:
    return float(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


def _row(
    kind: float,
    point: Vector,
    texture: Texture,
    u: Vector | F64,
    v: Vector | F64,
    normal: Vector | F64,
    radius: float = 0.0,
) -> F64:
    return np.array([kind, *point, *u, *v, *normal, radius, texture.mean, texture.contrast, texture.period_m])

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Range images of the corner of a room with spheres in it, in closed form, from any pose."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.stages.depth import depth_sigma
from stereo_depth_ros.surfaces.range_image import RangeImage

GEOMETRY = Triangulation(130.0, 124.0, 75.5, 62.0, 0.12, 0.0)
SIZE = (152, 118)
SIGMA_PX = 0.05

# n X <= h is inside of the room: back wall, right wall and floor, none at a right angle to the others.
BACK = ((0.12, -0.1, 1.0), 2.2)
RIGHT = ((1.0, 0.05, 0.25), 1.1)
FLOOR = ((-0.08, 1.0, 0.1), 0.75)
CORNER = (BACK, RIGHT, FLOOR)
SPHERE = ((-0.35, 0.25, 1.55), 0.3)


def motion(rotation_deg: Sequence[float], translation_m: Sequence[float]) -> Pose:
    """A pose of a rotation vector in degrees, and a translation."""
    R = cv2.Rodrigues(np.radians(np.array(rotation_deg, np.float64)))[0]
    return Pose(np.asarray(R, np.float64), np.array(translation_m, np.float64))


def rendered(
    world_from_camera: Pose,
    seed: int | None = None,
    *,
    planes: Sequence[tuple[tuple[float, float, float], float]] = CORNER,
    spheres: Sequence[tuple[tuple[float, float, float], float]] = (SPHERE,),
    sigma_px: float = SIGMA_PX,
) -> RangeImage:
    """What a camera sees, with the noise of disparities where a seed is given."""
    width, height = SIZE
    g = GEOMETRY
    y, x = np.indices((height, width))
    rays = np.stack(((x - g.cx_px) / g.f_px, (y - g.cy_px) / g.fy_px, np.ones((height, width))), axis=2)
    d, o = rays @ world_from_camera.rotation.T, world_from_camera.translation_m
    depth = np.full((height, width), np.inf)
    for normal, distance in planes:
        n = np.array(normal) / np.linalg.norm(normal)
        with np.errstate(divide="ignore"):
            hit = (distance - n @ o) / (d @ n)
        depth = np.where((hit > 0) & (hit < depth), hit, depth)
    for center, radius in spheres:
        depth = np.minimum(depth, _sphere(d, o - np.array(center), radius))
    depth[~np.isfinite(depth)] = np.nan
    if seed is not None:
        noise_px = np.random.default_rng(seed).normal(0, sigma_px, depth.shape)
        depth = 1 / (1 / depth + noise_px / (g.f_px * g.baseline_m))
    depth32 = depth.astype(np.float32)
    color = np.stack((x % 256, y % 256, (3 * x + 5 * y) % 256), axis=2).astype(np.uint8)
    return RangeImage(depth32, depth_sigma(depth32, g, sigma_px), g, color)


def _sphere(d: F64, o: F64, radius: float) -> F64:
    a, b = np.sum(d * d, axis=2), d @ o
    with np.errstate(invalid="ignore"):
        hit = (-b - np.sqrt(b * b - a * (o @ o - radius**2))) / a
    return np.where(hit > 0, hit, np.inf)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sweeps of a laser scanner that looks at a synthetic scene, with exact geometry and noise of the ranges."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.synthetic.rays import in_shadow, trace
from stereo_depth_ros.synthetic.scene import Scene

# the axes of a scanner, x forward, y left, z up, in those of a camera
CAMERA_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def lidar_points(
    scene: Scene,
    world_from_lidar: Pose,
    *,
    rings: int = 64,
    elevation_deg: tuple[float, float] = (-30.0, 20.0),
    azimuth_deg: float = 45.0,
    step_deg: float = 0.4,
    noise_m: float = 0.02,
    seed: int = 5,
) -> F32:
    """float32 (N, 3) in the frame of the scanner, x forward, y left, z up, ring by ring, meters.

    Args:
        scene: the scene.
        world_from_lidar: the pose of the scanner.
        rings: number of rings, from the lower to the upper elevation.
        elevation_deg: of the lowest and the highest ring.
        azimuth_deg: largest, to both sides.
        step_deg: between the rays of a ring.
        noise_m: standard deviation of the ranges.
        seed: of the noise.
    """
    elevation = np.radians(np.linspace(*elevation_deg, rings))[:, None]
    azimuth = np.radians(np.arange(-azimuth_deg, azimuth_deg, step_deg))[None]
    rays = np.stack(
        [np.broadcast_to(-np.tan(azimuth), (rings, azimuth.size)), -np.tan(elevation) / np.cos(azimuth)], axis=2
    )
    shape = rays.shape[:2]
    points, normals, levels = np.empty((*shape, 3)), np.empty((*shape, 3)), np.empty(shape)
    rotation = np.ascontiguousarray(world_from_lidar.rotation @ CAMERA_AXES.T)
    geometry = (scene.packed(), world_from_lidar.translation_m, rotation, np.ascontiguousarray(rays))
    trace(0, rings, *geometry, math.radians(step_deg), 1, points, normals, levels, np.empty(shape, np.int32))
    local = world_from_lidar.inverse().apply(points[np.isfinite(points[..., 0])])
    ranges = np.linalg.norm(local, axis=1, keepdims=True)
    noise = np.random.default_rng(seed).normal(0, noise_m, ranges.shape)
    return np.asarray(local * (1 + noise / ranges), np.float32)


def hidden_points(scene: Scene, points_m: F64, camera_center: F64) -> npt.NDArray[np.bool_]:
    """bool (N,): whether a surface is between the camera and each point of the world, float64 (N, 3)."""
    shadow = np.empty((1, len(points_m)), np.bool_)
    nearer = camera_center + 0.98 * (points_m - camera_center)  # before the surface in spite of the noise
    in_shadow(0, 1, scene.packed(), np.ascontiguousarray(nearer[None]), camera_center, shadow)
    return shadow[0]

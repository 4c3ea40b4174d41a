# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two different cameras that are known exactly, and their projections of points."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import fundamental_from_pose
from stereo_depth_ros.geometry.relative_pose import RelativePose

K_LEFT = np.array([[455.0, 0.0, 371.0], [0.0, 461.0, 236.0], [0.0, 0.0, 1.0]])
K_RIGHT = np.array([[512.0, 0.0, 340.0], [0.0, 507.0, 259.0], [0.0, 0.0, 1.0]])
SIZE = (740, 480)
POSE = RelativePose(cv2.Rodrigues(np.array([0.03, -0.08, 0.05]))[0], np.array([-0.31, 0.04, 0.06]))
F_TRUE = fundamental_from_pose(POSE, K_LEFT, K_RIGHT)


@dataclass(frozen=True, eq=False)
class Views:
    """Points in the left camera, float64 (N, 3) m, and their projections, float64 (N, 2) px each."""

    points_m: F64
    left_px: F64
    right_px: F64


def views(
    count: int, noise_px: float = 0.0, seed: int = 0, pose: RelativePose = POSE, depth_m: tuple[float, float] = (2, 9)
) -> Views:
    """Random points at all depths, with noise in both images."""
    random = np.random.default_rng(seed)
    pixels = random.uniform((40, 30), (SIZE[0] - 40, SIZE[1] - 30), (count, 2))
    points = pixels_at(pixels, random.uniform(*depth_m, count))
    return seen(points, noise_px, seed, pose)


def plane_views(count: int, noise_px: float = 0.0, seed: int = 0) -> Views:
    """Random points of a tilted plane."""
    random = np.random.default_rng(seed)
    pixels = random.uniform((40, 30), (SIZE[0] - 40, SIZE[1] - 30), (count, 2))
    rays = pixels_at(pixels, np.ones(count))
    return seen(rays * (4.0 / (rays @ np.array([0.4, -0.3, 1.0])))[:, None], noise_px, seed, POSE)


def pixels_at(pixels: F64, depth_m: F64) -> F64:
    """Points, float64 (N, 3), at pixels of the left camera."""
    rays: F64 = np.column_stack((pixels, np.ones(len(pixels)))) @ np.linalg.inv(K_LEFT).T
    return rays * depth_m[:, None]


def seen(points_m: F64, noise_px: float, seed: int, pose: RelativePose = POSE) -> Views:
    """Projections of points in both cameras."""
    random = np.random.default_rng(seed + 1)
    left = project(points_m, K_LEFT) + noise_px * random.standard_normal((len(points_m), 2))
    right = project(points_m @ pose.R.T + pose.t, K_RIGHT) + noise_px * random.standard_normal((len(points_m), 2))
    return Views(points_m, left, right)


def project(points: F64, K: F64) -> F64:
    """float64 (N, 2), px."""
    pixels: F64 = points @ K.T
    return pixels[:, :2] / pixels[:, 2:]

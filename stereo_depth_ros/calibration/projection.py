# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Projection of points through a lens, with its derivatives, for the distortion models of camera infos."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F64

__all__ = [
    "MODELS",
    "Projection",
    "camera_matrix",
    "check_model",
    "parameter_names",
    "project",
    "turning_radius_px",
]

# in OpenCV's order
MODELS: Mapping[str, tuple[str, ...]] = {
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}


class Projection(NamedTuple):
    """Pixels of N points and their derivatives.

    Attributes:
        image_px: float64 (N, 2).
        by_intrinsics: float64 (2 N, 4 + n), rows x, y of each point; columns fx, fy, cx, cy, coefficients.
        by_pose: float64 (2 N, 6), columns rotation vector, translation.
    """

    image_px: F64
    by_intrinsics: F64
    by_pose: F64


def check_model(model: str) -> None:
    """Raise ConfigError where there is no distortion model of this name."""
    if model not in MODELS:
        raise ConfigError(f"model {model!r} is none of {', '.join(MODELS)}: name one of them")


def parameter_names(model: str) -> tuple[str, ...]:
    """Names of the intrinsic parameters, in their order."""
    return ("fx", "fy", "cx", "cy", *MODELS[model])


def camera_matrix(intrinsics: F64) -> F64:
    """K, float64 (3, 3), of intrinsics (fx, fy, cx, cy, coefficients)."""
    fx, fy, cx, cy = intrinsics[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def project(model: str, intrinsics: F64, pose: F64, points_m: F64) -> Projection:
    """Points of the board in the image.

    Args:
        model: distortion model.
        intrinsics: float64 (4 + n,): fx, fy, cx, cy in px, coefficients.
        pose: float64 (6,): rotation vector and translation in meters from the board to the camera.
        points_m: float64 (N, 3) on the board.
    """
    K, D, points = camera_matrix(intrinsics), intrinsics[4:], points_m.reshape(-1, 1, 3)
    if model == "equidistant":  # columns f, c, k, rotation, translation, skew
        pixels, J = cv2.fisheye.projectPoints(points, pose[:3], pose[3:], K, D)
        return Projection(pixels.reshape(-1, 2), J[:, :8], J[:, 8:14])
    pixels, J = cv2.projectPoints(points, pose[:3], pose[3:], K, D)  # columns rotation, translation, f, c, coefficients
    return Projection(pixels.reshape(-1, 2), J[:, 6 : 10 + D.size], J[:, :6])


def turning_radius_px(model: str, intrinsics: F64, size: tuple[int, int]) -> tuple[float, float]:
    """Radius in the image beyond which the radial distortion folds back, and that of the farthest image corner, px.

    A lens maps larger angles to larger radii. Coefficients are only known where corners were seen: beyond them the
    polynomials may turn. Infinite where they do not within the image.
    """
    focal_px = float(np.sqrt(intrinsics[0] * intrinsics[1]))
    corners = np.array([[x, y] for x in (0, size[0] - 1) for y in (0, size[1] - 1)]) - intrinsics[2:4]
    corner_px = float(np.linalg.norm(corners, axis=1).max())
    k = dict(zip(MODELS[model], intrinsics[4:], strict=True))
    if model == "equidistant":
        r = np.linspace(0, np.pi, 3000)
        bent = r * (1 + k["k1"] * r**2 + k["k2"] * r**4 + k["k3"] * r**6 + k["k4"] * r**8)
    else:
        r = np.linspace(0, 10 * corner_px / focal_px, 20000)
        below = 1 + k.get("k4", 0.0) * r**2 + k.get("k5", 0.0) * r**4 + k.get("k6", 0.0) * r**6
        bent = r * (1 + k["k1"] * r**2 + k["k2"] * r**4 + k["k3"] * r**6) / below
    radius_px = focal_px * bent
    turns = np.flatnonzero(np.diff(radius_px) <= 0)
    if not turns.size or radius_px[turns[0]] >= corner_px:
        return float("inf"), corner_px
    return float(radius_px[turns[0]]), corner_px

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Projection of points by camera models with lens distortion, its Jacobians, and the range of the distortion."""

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
    "distortion_range_px",
    "parameter_names",
    "project",
]

# in OpenCV's order
MODELS: Mapping[str, tuple[str, ...]] = {
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}


class Projection(NamedTuple):
    """Pixels of N points and their Jacobians.

    Attributes:
        image_px: float64 (N, 2).
        jacobian_intrinsics: float64 (2 N, 4 + n), rows x, y of each point; columns fx, fy, cx, cy, coefficients.
        jacobian_pose: float64 (2 N, 6), columns rotation vector, translation.
    """

    image_px: F64
    jacobian_intrinsics: F64
    jacobian_pose: F64


def check_model(model: str) -> None:
    """Raise ConfigError where no distortion model has this name."""
    if model not in MODELS:
        raise ConfigError(
            f"model {model!r} is not one of {', '.join(MODELS)}",
            value=model,
            limit=tuple(MODELS),
            remedy="use one of them",
            settings=("model",),
        )


def parameter_names(model: str) -> tuple[str, ...]:
    """Names of the intrinsic parameters, in order."""
    return ("fx", "fy", "cx", "cy", *MODELS[model])


def camera_matrix(intrinsics: F64) -> F64:
    """K, float64 (3, 3), from intrinsics (fx, fy, cx, cy, coefficients)."""
    fx, fy, cx, cy = intrinsics[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def project(model: str, intrinsics: F64, pose: F64, points_m: F64) -> Projection:
    """Project points of the board into the image.

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


def distortion_range_px(model: str, intrinsics: F64, size: tuple[int, int]) -> tuple[float, float]:
    """Image radius up to which the radial distortion increases, and the radius of the farthest image corner, px.

    A lens maps larger angles to larger radii; fitted polynomials may decrease where no corners were detected. The range
    is infinite where it includes the whole image.
    """
    focal_px = float(np.sqrt(intrinsics[0] * intrinsics[1]))
    corners = np.array([[x, y] for x in (0, size[0] - 1) for y in (0, size[1] - 1)]) - intrinsics[2:4]
    corner_px = float(np.linalg.norm(corners, axis=1).max())
    k = dict(zip(MODELS[model], intrinsics[4:], strict=True))
    if model == "equidistant":
        r = np.linspace(0, np.pi, 3000)
        distorted = r * (1 + k["k1"] * r**2 + k["k2"] * r**4 + k["k3"] * r**6 + k["k4"] * r**8)
    else:
        r = np.linspace(0, 10 * corner_px / focal_px, 20000)
        denominator = 1 + k.get("k4", 0.0) * r**2 + k.get("k5", 0.0) * r**4 + k.get("k6", 0.0) * r**6
        distorted = r * (1 + k["k1"] * r**2 + k["k2"] * r**4 + k["k3"] * r**6) / denominator
    radius_px = focal_px * distorted
    decreasing = np.flatnonzero(np.diff(radius_px) <= 0)
    if not decreasing.size or radius_px[decreasing[0]] >= corner_px:
        return float("inf"), corner_px
    return float(radius_px[decreasing[0]]), corner_px

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The synthetic rig: two verged cameras with different lens distortion, and their rectification.

It is asymmetric on purpose, since equal values hide swapped ones: different lenses, a right camera that is rotated
towards the left one and slightly rolled, fx != fy, and different rectified principal points.

All rotations are rounded to 12 decimals, so that results do not depend on the last bit of sine and cosine.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

__all__ = [
    "CENTER_LEFT_RIGHT_M",
    "R_RIGHT_LEFT",
    "inside_raw_image",
    "product",
    "raw_pixels",
    "rotation_into",
    "synthetic_rig",
]

_WIDTH, _HEIGHT = 640, 480  # of the values below, which are scaled to other sizes
_K_LEFT = ((415.3, 0.0, 321.4), (0.0, 409.8, 236.2), (0.0, 0.0, 1.0))
_K_RIGHT = ((419.6, 0.0, 316.7), (0.0, 413.9, 243.5), (0.0, 0.0, 1.0))
_D_LEFT = (-0.21, 0.06, 0.0006, -0.0004, -0.005)
_D_RIGHT = (-0.19, 0.05, -0.0005, 0.0007, -0.004)
_F_PX, _FY_PX, _CY_PX = 430.0, 417.1, 238.5
# Principal points that center both images of a verged pair give negative disparities beyond the point where the optical
# axes cross. These give infinity a disparity of +9.5 px, so that the whole room is in the default range of 0 to 63.
_CX_LEFT_PX, _CX_RIGHT_PX = 316.25, 306.75


def rotation_into(yaw_rad: float, pitch_rad: float, roll_rad: float) -> F64:
    """Rotation, float64 (3, 3), into a camera that is rotated about its y (down), then x (right), then z axis."""
    a, b = math.cos(yaw_rad), math.sin(yaw_rad)
    yaw = np.array([[a, 0.0, b], [0.0, 1.0, 0.0], [-b, 0.0, a]])
    a, b = math.cos(pitch_rad), math.sin(pitch_rad)
    pitch = np.array([[1.0, 0.0, 0.0], [0.0, a, -b], [0.0, b, a]])
    a, b = math.cos(roll_rad), math.sin(roll_rad)
    roll = np.array([[a, -b, 0.0], [b, a, 0.0], [0.0, 0.0, 1.0]])
    return product(roll, pitch, yaw)


def product(*matrices: F64) -> F64:
    """Matrix product, rounded to 12 decimals, so that it does not depend on the order of summation."""
    result = matrices[0]
    for matrix in matrices[1:]:
        result = result @ matrix
    return np.ascontiguousarray(np.round(result, 12))


# X_right = R_RIGHT_LEFT (X_left - CENTER_LEFT_RIGHT_M)
R_RIGHT_LEFT = rotation_into(math.radians(2.0), math.radians(0.3), math.radians(0.5))
CENTER_LEFT_RIGHT_M = np.array([0.12, 0.003, -0.002])


def synthetic_rig(width: int, height: int) -> StereoRig:
    """The rig at an image size in pixels; the field of view is the same at all sizes."""
    R_left = _rectifying_rotation()
    R_right = product(R_left, R_RIGHT_LEFT.T)
    baseline_m = round(math.sqrt(float(np.sum(CENTER_LEFT_RIGHT_M**2))), 12)
    scale = np.array([[width / _WIDTH], [height / _HEIGHT], [1.0]])
    half_pixel = 0.5 * (scale - 1.0)  # scaling keeps the outer edges of the image, not the pixel centers

    def scaled(matrix: npt.ArrayLike) -> F64:
        result: F64 = np.asarray(matrix, dtype=np.float64) * scale
        result[:, 2:3] += half_pixel
        return result

    def camera(K: npt.ArrayLike, D: npt.ArrayLike, R: F64, cx: float, baseline_m: float, side: str) -> CameraModel:
        P = scaled(((_F_PX, 0.0, cx, -_F_PX * baseline_m), (0.0, _FY_PX, _CY_PX, 0.0), (0.0, 0.0, 1.0, 0.0)))
        return CameraModel(
            width, height, "plumb_bob", scaled(K), np.asarray(D), R, P, frame_id=f"{side}_camera_optical_frame"
        )

    return StereoRig(
        camera(_K_LEFT, _D_LEFT, R_left, _CX_LEFT_PX, 0.0, "left"),
        camera(_K_RIGHT, _D_RIGHT, R_right, _CX_RIGHT_PX, baseline_m, "right"),
    )


def inside_raw_image(camera: CameraModel, points: F64) -> npt.NDArray[np.bool_]:
    """Whether points, float64 (..., 3) in the rectified frame of ``camera``, project into its raw image; bool (...)."""
    u, v, z = raw_pixels(camera, points @ camera.R)  # R^T X for rows
    with np.errstate(invalid="ignore"):
        inside: npt.NDArray[np.bool_] = (
            (z > 0) & (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
        )
    return inside


def raw_pixels(camera: CameraModel, points: F64) -> tuple[F64, F64, F64]:
    """Column and row, px, and depth of points, float64 (..., 3) in the raw frame of a plumb_bob camera."""
    z = points[..., 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y = points[..., 0] / z, points[..., 1] / z
        k1, k2, p1, p2, k3 = camera.D
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = camera.K[0, 0] * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + camera.K[0, 2]
        v = camera.K[1, 1] * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + camera.K[1, 2]
    return u, v, z


def _rectifying_rotation() -> F64:
    """Rotation from left raw to rectified: x along the baseline, z closest to the mean of the optical axes."""
    x = CENTER_LEFT_RIGHT_M / np.sqrt(np.sum(CENTER_LEFT_RIGHT_M**2))
    y = np.cross(np.array([0.0, 0.0, 1.0]) + R_RIGHT_LEFT[2], x)
    y /= np.sqrt(np.sum(y**2))
    return product(np.stack([x, y, np.cross(x, y)]))

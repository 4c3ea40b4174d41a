# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Field of view of a camera, lens distortion included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.rays import camera_rays

__all__ = ["FieldOfView", "field_of_view"]


@dataclass(frozen=True)
class FieldOfView:
    """Angles between opposite edges through the principal point, and between opposite corners, degrees.

    NaN where the distortion model has no ray for an edge or corner.
    """

    horizontal_deg: float
    vertical_deg: float
    diagonal_deg: float


def field_of_view(camera: CameraModel) -> FieldOfView:
    """Field of view of the raw image; of the rectified image with ``camera.rectified()``.

    Each angle is the sum of the angles of its two ends from the optical axis, so that it may exceed 180 degrees. The
    image ends half a pixel beyond the centers of its outermost pixels. The larger diagonal is used.
    """
    left, top, right, bottom = -0.5, -0.5, camera.width - 0.5, camera.height - 0.5
    cx, cy = camera.K[0, 2], camera.K[1, 2]
    ends = [(left, cy), (right, cy), (cx, top), (cx, bottom)]
    corners = [(left, top), (right, bottom), (left, bottom), (right, top)]
    horizontal, vertical, falling, rising = (
        np.degrees(_angles_from_axis(np.array(ends + corners), camera)).reshape(4, 2).sum(axis=1).tolist()
    )
    return FieldOfView(horizontal, vertical, float(np.maximum(falling, rising)))


def _angles_from_axis(points_px: F64, camera: CameraModel) -> F64:
    """float64 (N,), radians; NaN where there is no ray."""
    rays = camera_rays(points_px, camera)
    angles: F64 = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    return angles

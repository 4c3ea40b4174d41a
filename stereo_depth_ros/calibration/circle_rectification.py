# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectification of fisheyes whose image is a circle: the rectified images show nothing from outside of it."""

from __future__ import annotations

import math

import numpy as np

from stereo_depth_ros.calibration.bundle_adjustment import BundleParameters
from stereo_depth_ros.calibration.distortion_range import Circles
from stereo_depth_ros.calibration.lens_circle import LensCircle
from stereo_depth_ros.calibration.projection import camera_matrix, distortion_range_px
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.calibrated_rectification import rectifying_rotations
from stereo_depth_ros.geometry.relative_pose import RelativePose

__all__ = ["rectified_in_circles"]

_MAX_ANGLE = math.radians(60)  # from the axis: a perspective image stretches what is farther out
_MIN_ANGLE = math.radians(5)


def rectified_in_circles(
    parameters: BundleParameters, R: F64, T: F64, size: tuple[int, int], circles: Circles
) -> StereoRig:
    """The rectified rig of two fisheyes with image circles.

    OpenCV derives P from the centers of the image edges, which no ray of such a lens reaches. Here the corners of the
    rectified image are as far from the axis as both circles reach, and at most 60 degrees.

    Args:
        parameters: of both cameras, model equidistant.
        R, T: float64 (3, 3) and (3,) in meters, X_right = R X_left + T.
        size: width, height of raw and rectified images, px.
        circles: of the left and the right lens, one of them at least; the image of a lens without one is the limit.

    Raises:
        CalibrationError: the circles have no view in common, or the baseline is not along the rows.
    """
    rotations = rectifying_rotations(RelativePose(R, T))
    angles = [
        _angle(intrinsics, size, circle) - math.acos(min(1.0, float(rotation[2, 2])))
        for intrinsics, circle, rotation in zip(parameters.intrinsics, circles, rotations, strict=True)
    ]
    angle = min(*angles, _MAX_ANGLE)
    if angle < _MIN_ANGLE:
        raise CalibrationError(
            "the image circles of both lenses have hardly any view in common",
            value=math.degrees(angle),
            limit=math.degrees(_MIN_ANGLE),
            remedy="point both cameras in one direction",
        )
    f_px = math.hypot(*size) / 2 / math.tan(angle)
    cx, cy = (size[0] - 1) / 2, (size[1] - 1) / 2
    cameras = []
    for intrinsics, rotation, baseline_m in zip(
        parameters.intrinsics, rotations, (0.0, float(np.linalg.norm(T))), strict=True
    ):
        P = np.array([[f_px, 0, cx, -f_px * baseline_m], [0, f_px, cy, 0], [0, 0, 1, 0]])
        cameras.append(
            CameraModel(
                *size, parameters.model, camera_matrix(intrinsics), intrinsics[4:], rotation, P, "left_optical_frame"
            )
        )
    return StereoRig(cameras[0], cameras[1])


def _angle(intrinsics: F64, size: tuple[int, int], circle: LensCircle | None) -> float:
    """Angle from the optical axis up to which all directions are in the image, radians."""
    fx, fy, cx, cy = intrinsics[:4]
    edge_px = min(cx, size[0] - 1 - cx, cy, size[1] - 1 - cy)
    if circle is not None:
        edge_px = circle.radius - math.hypot(circle.x - cx, circle.y - cy)
    radius_px = min(edge_px, 0.99 * distortion_range_px("equidistant", intrinsics, size)[0])
    theta = np.linspace(0, math.pi, 3000)
    k1, k2, k3, k4 = intrinsics[4:8]
    distorted = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    reached = np.flatnonzero(math.sqrt(fx * fy) * distorted >= radius_px)
    return float(theta[reached[0] if reached.size else -1])

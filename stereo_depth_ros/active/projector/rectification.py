# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectification of a camera and a projector that may stand on any side of it and may be shifted or verged."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from stereo_depth_ros.active.projector.raster import Size, resized_camera
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.calibrated_rectification import Outline, Rectangle
from stereo_depth_ros.geometry.rays import camera_rays
from stereo_depth_ros.geometry.relative_pose import RelativePose

__all__ = ["rectify_camera_and_projector"]

_MAX_ANGLE = math.radians(75)  # from the rectified axis, of what is shown
_LEAST_ANGLE_DEG = 20.0  # between the baseline and the view, below which an epipole is in or near the image


def rectify_camera_and_projector(camera: CameraModel, projector: CameraModel, pose: RelativePose) -> StereoRig:
    """The rig of a camera (left) and a projector (right); their own R and P are not used.

    As the textbook's rectification (Trucco and Verri, Introductory Techniques for 3-D Computer Vision, 1998, section
    7.3.7), but x points from the camera to the projector wherever it stands, and z along the mean direction of both
    images rather than along an optical axis, which the lens shift of a projector moves out of its image. The rectified
    image is turned by 90 degrees where the projector stands above the camera, by 180 degrees where it stands to the
    left. Its focal length and principal points keep all that both have in view: no more of the camera's image, whose
    resolution is kept if it fits.

    Args:
        camera: K, D and size of the raw image.
        projector: the same of the projector, in its own pixels.
        pose: of the projector, X_projector = R X_camera + t, meters.

    Raises:
        CalibrationError: an epipole is in or near an image, or nothing is in view of both.
    """
    size: Size = (camera.width, camera.height)
    resized = resized_camera(projector, size)
    rotation = _rotation(camera, resized, pose)
    cameras = (replace(camera, R=rotation), replace(resized, R=rotation @ pose.R.T))
    shown = _common_view(*(Outline.of(each, _MAX_ANGLE).outer for each in cameras))
    f_px = min(float(max(camera.K[0, 0], camera.K[1, 1])), _focal_px(shown[0], size))
    rectified = []
    for each, view, baseline_m in zip(cameras, shown, (0.0, float(np.linalg.norm(pose.t))), strict=True):
        cx, cy = _middle(size[0], f_px, view.x0, view.x1), _middle(size[1], f_px, view.y0, view.y1)
        P = np.array([[f_px, 0, cx, -f_px * baseline_m], [0, f_px, cy, 0], [0, 0, 1, 0]])
        rectified.append(replace(each, P=P))
    return StereoRig(rectified[0], rectified[1])


def _rotation(camera: CameraModel, projector: CameraModel, pose: RelativePose) -> F64:
    """R of the camera, float64 (3, 3): x along the baseline, z along the mean of both views."""
    baseline = pose.right_center / np.linalg.norm(pose.right_center)
    view = _center_ray(camera) + pose.R.T @ _center_ray(projector)
    view /= np.linalg.norm(view)
    angle_deg = math.degrees(math.acos(min(1.0, abs(float(baseline @ view)))))
    if angle_deg < _LEAST_ANGLE_DEG:
        raise CalibrationError(
            f"the projector is {angle_deg:.1f} degrees off the direction of view, limit {_LEAST_ANGLE_DEG:g}: an "
            "epipole is in or near an image, and no rotation makes the rows parallel",
            subject="rectification",
            value=angle_deg,
            limit=_LEAST_ANGLE_DEG,
            remedy="mount the projector beside the camera or above it, not in front or behind",
        )
    z = view - (view @ baseline) * baseline
    z /= np.linalg.norm(z)
    rotation: F64 = np.stack((baseline, np.cross(z, baseline), z))
    return rotation


def _center_ray(camera: CameraModel) -> F64:
    center = np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]])
    ray: F64 = camera_rays(center, camera)[0]
    return ray if np.isfinite(ray).all() else np.array([0.0, 0.0, 1.0])


def _common_view(left: Rectangle, right: Rectangle) -> tuple[Rectangle, Rectangle]:
    """What of each view may be seen by the other: the same rows, and columns x_left > x_right, as depth is positive."""
    y0, y1 = max(left.y0, right.y0), min(left.y1, right.y1)
    views = (
        Rectangle(max(left.x0, right.x0), y0, left.x1, y1),
        Rectangle(right.x0, y0, min(left.x1, right.x1), y1),
    )
    if y1 <= y0 or any(view.x1 <= view.x0 for view in views):
        raise CalibrationError(
            "camera and projector have no field of view in common",
            subject="rectification",
            remedy="point both at one scene, and calibrate again",
        )
    return views


def _focal_px(view: Rectangle, size: Size) -> float:
    """The focal length at which a view fits into an image."""
    return min((size[0] - 1) / (view.x1 - view.x0), (size[1] - 1) / (view.y1 - view.y0))


def _middle(length: int, f_px: float, low: float, high: float) -> float:
    """The principal point at which the middle of a view is that of the image."""
    return (length - 1) / 2 - f_px * (low + high) / 2

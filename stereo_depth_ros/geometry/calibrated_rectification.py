# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectification of calibrated cameras: rotations, projection matrices and the common area of the rectified images."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from stereo_depth_ros.core.camera import CameraModel, check_intrinsics
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.rays import camera_rays
from stereo_depth_ros.geometry.relative_pose import RelativePose

__all__ = [
    "METHODS",
    "Area",
    "Outline",
    "Rectangle",
    "common_area",
    "rectify_calibrated",
    "rectifying_rotations",
]

METHODS = ("textbook", "opencv")
MAX_TILT_DEG = 45.0  # of the baseline against the rows
_EDGE_POINTS = 33
_INSET_PX = 0.05  # so that rectified pixels have a source although the maps are rounded to 1/32 px


class Area(NamedTuple):
    """A rectangle of rectified pixels: first column and row, number of columns and rows."""

    x: int
    y: int
    width: int
    height: int


def rectify_calibrated(
    left: CameraModel,
    right: CameraModel,
    pose: RelativePose,
    *,
    method: str = "textbook",
    alpha: float = 0.0,
    max_fov_deg: float = 120.0,
    zero_disparity: bool = True,
) -> StereoRig:
    """Rectify two cameras; their own R and P are not used.

    "textbook" rotates the left camera so that its epipole is at infinity along the rows, with the new y axis
    orthogonal to the old optical axis, and the right camera by the same rotation after that of the pose (Trucco and
    Verri, Introductory Techniques for 3-D Computer Vision, 1998, section 7.3.7; Fusiello, Trucco and Verri 2000).
    "opencv" is ``cv2.stereoRectify`` or ``cv2.fisheye.stereoRectify``, which rotates each camera by half the relative
    rotation.

    Args:
        left, right: K, D and size of the raw images.
        pose: of the right camera, t in meters.
        method: "textbook" or "opencv".
        alpha: 0 keeps only pixels that have a source in the raw images, 1 keeps all raw pixels, values between
            interpolate; the balance of OpenCV's fisheye module.
        max_fov_deg: field of view kept; rays further than half of it from the axis are cropped; "textbook" only.
        zero_disparity: points at infinity have disparity 0; with False each principal point is centered on what its
            camera sees, so that cameras that converge keep more in common; "textbook" only.

    Raises:
        ConfigError: an unknown method, or a parameter out of range.
        CalibrationError: invalid intrinsics, a pose up to scale, a baseline that is not along the rows, or a baseline
            out of range.
    """
    _check_parameters(method, alpha, max_fov_deg)
    for camera, label in ((left, "left camera"), (right, "right camera")):
        check_intrinsics(camera, label)
    R_left, R_right = rectifying_rotations(pose)
    if pose.up_to_scale:
        raise CalibrationError(
            "the pose is known up to scale, P needs meters",
            subject="relative pose",
            remedy="measure the baseline and scale t by it",
            settings=("baseline",),
        )
    if method == "opencv":
        return StereoRig.from_calibration(
            left.K, left.D, right.K, right.D, pose.R, pose.t, _size(left), left.distortion_model, left.frame_id, alpha
        )
    cameras = (replace(left, R=R_left), replace(right, R=R_right))
    outlines = [Outline.of(camera, math.radians(max_fov_deg) / 2) for camera in cameras]
    if zero_disparity:
        outlines = [outlines[0].combined(outlines[1])] * 2
    f_px, principal_points = _intrinsics(outlines, _size(left), alpha)
    baselines_m = (0.0, float(np.linalg.norm(pose.t)))
    P_left, P_right = (
        np.array([[f_px, 0, cx, -f_px * baseline_m], [0, f_px, cy, 0], [0, 0, 1, 0]])
        for (cx, cy), baseline_m in zip(principal_points, baselines_m, strict=True)
    )
    return StereoRig(replace(cameras[0], P=P_left), replace(cameras[1], P=P_right))


def rectifying_rotations(pose: RelativePose) -> tuple[F64, F64]:
    """R of both cameras, float64 (3, 3), with rows e1 along the baseline, e2 = z x e1 normalized, e3 = e1 x e2.

    Raises:
        CalibrationError: the right camera is not within 45 degrees of the left camera's x axis.
    """
    T = pose.right_center
    e1 = T / np.linalg.norm(T)
    _check_direction(e1)
    e2 = np.array([-e1[1], e1[0], 0.0]) / math.hypot(e1[0], e1[1])
    R_left: F64 = np.stack((e1, e2, np.cross(e1, e2)))
    return R_left, R_left @ pose.R.T


def common_area(rig: StereoRig) -> Area:
    """The rectangle of rows and columns in which both rectified images have a source.

    Empty (width or height 0) where they have no pixel in common; slightly too small for strong barrel distortion.
    """
    x0, y0, x1, y1 = 0.0, 0.0, rig.width - 1.0, rig.height - 1.0
    for camera in (rig.left, rig.right):
        inner = Outline.of(camera, math.pi / 2 - 1e-3).inner
        fx, fy, cx, cy = camera.P[0, 0], camera.P[1, 1], camera.P[0, 2], camera.P[1, 2]
        x0, x1 = max(x0, fx * inner.x0 + cx), min(x1, fx * inner.x1 + cx)
        y0, y1 = max(y0, fy * inner.y0 + cy), min(y1, fy * inner.y1 + cy)
    x, y = math.ceil(x0), math.ceil(y0)
    return Area(x, y, max(0, math.floor(x1) - x + 1), max(0, math.floor(y1) - y + 1))


class Rectangle(NamedTuple):
    """Ranges of x / z and y / z in the rectified camera."""

    x0: float
    y0: float
    x1: float
    y1: float


class Outline(NamedTuple):
    """Coverage of the raw image in the rectified camera.

    Attributes:
        inner: rectangle within the raw image.
        outer: rectangle around the raw image.
    """

    inner: Rectangle
    outer: Rectangle

    @classmethod
    def of(cls, camera: CameraModel, limit_rad: float) -> Outline:
        """Outline of a camera by its R, up to this angle from the rectified axis."""
        left, right = _INSET_PX, camera.width - 1 - _INSET_PX
        top, bottom = _INSET_PX, camera.height - 1 - _INSET_PX
        along_x, along_y = np.linspace(left, right, _EDGE_POINTS), np.linspace(top, bottom, _EDGE_POINTS)
        edges = [
            np.column_stack(np.broadcast_arrays(x, y))
            for x, y in ((left, along_y), (along_x, top), (right, along_y), (along_x, bottom))
        ]
        sides = [_perspective(camera_rays(edge, camera) @ camera.R.T, limit_rad) for edge in edges]
        points = np.concatenate(sides)
        # the rectified image may be turned, as where the second camera is above the first one
        x, y = np.array([np.nanmean(side, axis=0) for side in sides]).T
        west, north, east, south = (sides[n] for n in (x.argmin(), y.argmin(), x.argmax(), y.argmax()))
        inner = np.nanmax(west[:, 0]), np.nanmax(north[:, 1]), np.nanmin(east[:, 0]), np.nanmin(south[:, 1])
        outer = (*np.nanmin(points, axis=0), *np.nanmax(points, axis=0))
        return cls(Rectangle(*map(float, inner)), Rectangle(*map(float, outer)))

    def combined(self, other: Outline) -> Outline:
        """The rectangle within both, and the rectangle around both."""
        (a, b), (c, d) = self, other
        inner = Rectangle(max(a.x0, c.x0), max(a.y0, c.y0), min(a.x1, c.x1), min(a.y1, c.y1))
        outer = Rectangle(min(b.x0, d.x0), min(b.y0, d.y0), max(b.x1, d.x1), max(b.y1, d.y1))
        return Outline(inner, outer)


def _perspective(rays: F64, limit_rad: float) -> F64:
    """float64 (N, 2), x / z and y / z; rays further from the axis than the limit are moved to it."""
    across = np.hypot(rays[:, 0], rays[:, 1])
    angle = np.minimum(np.arctan2(across, rays[:, 2]), limit_rad)
    points: F64 = rays[:, :2] * (np.tan(angle) / np.maximum(across, 1e-12))[:, None]
    return points


def _intrinsics(
    outlines: list[Outline], size: tuple[int, int], alpha: float
) -> tuple[float, list[tuple[float, float]]]:
    """Focal length and principal points of rectified images of this size, between their inner and outer outlines."""
    inner_px, inner = _fitted([outline.inner for outline in outlines], size, within=True)
    outer_px, outer = _fitted([outline.outer for outline in outlines], size, within=False)
    f_px = (1 - alpha) * inner_px + alpha * outer_px
    centers = (1 - alpha) * inner + alpha * outer
    return f_px, [((size[0] - 1) / 2 - f_px * x, (size[1] - 1) / 2 - f_px * y) for x, y in centers]


def _fitted(rectangles: list[Rectangle], size: tuple[int, int], within: bool) -> tuple[float, F64]:
    """Focal length at which the images are within their rectangles, or contain them, and the rectangles' centers."""
    x0, y0, x1, y1 = np.array(rectangles).T
    top, bottom = (y0.max(), y1.min()) if within else (y0.min(), y1.max())
    across = (x1 - x0).min() if within else (x1 - x0).max()
    if across <= 0 or bottom <= top:
        raise CalibrationError(
            "the rectified images have no field of view in common",
            remedy="check R of the pose, and that it belongs to these cameras",
        )
    scales = (size[0] - 1) / across, (size[1] - 1) / (bottom - top)
    centers = np.column_stack(((x0 + x1) / 2, np.full(len(x0), (top + bottom) / 2)))
    return float(max(scales) if within else min(scales)), centers


def _size(camera: CameraModel) -> tuple[int, int]:
    return camera.width, camera.height


def _check_parameters(method: str, alpha: float, max_fov_deg: float) -> None:
    if method not in METHODS:
        raise ConfigError(
            f"method {method!r} is not one of {', '.join(METHODS)}",
            value=method,
            limit=METHODS,
            remedy="use one of them",
            settings=("method",),
        )
    if not 0 <= alpha <= 1:
        raise ConfigError(
            f"alpha = {alpha:g} is outside 0..1",
            value=alpha,
            limit=(0, 1),
            remedy="use 0 for valid pixels only, 1 for all raw pixels",
            settings=("alpha",),
        )
    if not 10 <= max_fov_deg <= 170:
        raise ConfigError(
            f"max_fov_deg = {max_fov_deg:g} is outside 10..170",
            value=max_fov_deg,
            limit=(10, 170),
            remedy="use a smaller angle, a perspective image shows less than 180 degrees",
            settings=("max_fov_deg",),
        )


def _check_direction(e1: F64) -> None:
    tilt_deg = math.degrees(math.acos(np.clip(e1[0], -1, 1)))
    if tilt_deg <= MAX_TILT_DEG:
        return
    settings: tuple[str, ...] = ()
    if tilt_deg >= 180 - MAX_TILT_DEG:
        problem, remedy, settings = "left and right are swapped", "exchange them", ("left", "right")
    elif abs(e1[2]) > abs(e1[1]):
        problem = "it is ahead or behind, so that an epipole is in or near an image and no rotation makes rows agree"
        remedy = "mount the cameras side by side"
    else:
        problem = "it is above or below"
        remedy = "rotate the images by 90 degrees and calibrate them as left and right"
    raise CalibrationError(
        f"the right camera is {tilt_deg:.1f} degrees off the left camera's x axis, limit {MAX_TILT_DEG:g}: {problem}",
        value=tilt_deg,
        limit=MAX_TILT_DEG,
        remedy=remedy,
        settings=settings,
    )

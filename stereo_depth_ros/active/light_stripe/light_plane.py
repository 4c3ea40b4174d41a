# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Light plane, and triangulation of stripe points on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.light_stripe.profile import StripeProfile, StripeReason
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.rays import camera_rays

__all__ = ["LightPlane", "ProfilePoints", "profile_points", "search_range", "stripe_depth", "triangulate"]

_STEP_PX = 0.5  # of the derivative of a point by its place in the image
_COARSE_PX = 8  # between the pixels whose depth on the plane is computed


@dataclass(frozen=True, eq=False)
class LightPlane:
    """The plane A X + B Y + C Z + D = 0 that a laser lights, in the optical frame of a camera.

    Attributes:
        normal: float64 (3,), A, B, C, of length 1.
        d_m: D, meters.
        center_m: float64 (3,), the center of the points that it was fitted to, at which its errors are independent.
        tilt_axes: float64 (2, 3), unit vectors in the plane; the first one is the direction of its largest extent.
        offset_sigma_m: standard deviation of its distance from the center, meters.
        tilt_sigma: float64 (2,), standard deviations of its slopes along the tilt axes, radians.
    """

    normal: F64
    d_m: float
    center_m: F64
    tilt_axes: F64
    offset_sigma_m: float = 0.0
    tilt_sigma: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def exact(cls, normal: npt.ArrayLike, d_m: float) -> LightPlane:
        """A plane without uncertainty, from A, B, C, of any length, and D of the same scale."""
        vector = np.asarray(normal, np.float64)
        length = float(np.linalg.norm(vector))
        unit = vector / length
        return cls(unit, d_m / length, -d_m / length * unit, _axes(unit))

    def distances(self, points_m: F64) -> F64:
        """Signed distances of points, float64 (N, 3), from the plane, meters, float64 (N,)."""
        return np.asarray(points_m @ self.normal + self.d_m, np.float64)

    def sigma_m(self, points_m: F64) -> F64:
        """Standard deviation of the place of the plane at points, float64 (N, 3), along its normal, meters."""
        along = (points_m - self.center_m) @ self.tilt_axes.T
        return np.asarray(np.sqrt(self.offset_sigma_m**2 + np.square(along * self.tilt_sigma).sum(axis=1)))

    def moved(self, motion: F64) -> LightPlane:
        """The plane after a rigid motion, float64 (4, 4), of its points."""
        rotation, translation = motion[:3, :3], motion[:3, 3]
        normal = rotation @ self.normal
        return LightPlane(
            normal,
            float(self.d_m - normal @ translation),
            rotation @ self.center_m + translation,
            self.tilt_axes @ rotation.T,
            self.offset_sigma_m,
            self.tilt_sigma,
        )


def _axes(normal: F64) -> F64:
    """Two unit vectors perpendicular to each other and to the normal."""
    first = np.cross(normal, np.identity(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(normal, first)))


def stripe_depth(x_px: F64, y_px: F64, f_px: float, plane: LightPlane) -> F64:
    """Z = -D f / (A x + B y + C f), the depth of image points of a light plane A X + B Y + C Z + D = 0.

    It is the intersection of the ray X = x Z / f, Y = y Z / f with the plane.

    Args:
        x_px, y_px: float64 (N,), without lens distortion, from the principal point, px of one size in x and y.
        f_px: focal length in the same pixels.
        plane: the light plane.

    Returns:
        float64 (N,), meters; infinite where the ray is parallel to the plane, negative behind the camera.
    """
    A, B, C = plane.normal
    with np.errstate(divide="ignore"):
        return np.asarray(-plane.d_m * f_px / (A * x_px + B * y_px + C * f_px), np.float64)


def triangulate(points_px: F64, camera: CameraModel, plane: LightPlane) -> F64:
    """Points of the light plane at raw pixels of a camera, by :func:`stripe_depth`.

    Args:
        points_px: float64 (N, 2), columns x, y, px.
        camera: with lens distortion, and pixels that need not be square.
        plane: in the optical frame of the camera.

    Returns:
        float64 (N, 3), meters; NaN where the camera model has no ray, or the plane is not in front of the camera.
    """
    rays = camera_rays(points_px, camera)
    rays[rays[:, 2] <= 0] = np.nan
    f_px = float(camera.K[0, 0])
    x_px, y_px = f_px * rays[:, 0] / rays[:, 2], f_px * rays[:, 1] / rays[:, 2]  # square pixels of the width of the raw
    depth = stripe_depth(x_px, y_px, f_px, plane)
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    return np.column_stack((x_px * depth / f_px, y_px * depth / f_px, depth))


@dataclass(frozen=True, eq=False)
class ProfilePoints:
    """The points of one profile.

    Attributes:
        profile: the places in the image; lines without a point have a reason.
        lines: int64 (N,), line of each point.
        points_m: float64 (N, 3), in the optical frame, meters.
        sigma_m: float64 (N,), standard deviation along the ray by the noise of the image, meters.
        level: float64 (N,), gray levels.
    """

    profile: StripeProfile
    lines: npt.NDArray[np.int64]
    points_m: F64
    sigma_m: F64
    level: F64


def profile_points(
    profile: StripeProfile, camera: CameraModel, plane: LightPlane, config: LightStripeConfig
) -> ProfilePoints:
    """The points of a profile on the light plane; those of no use get a reason.

    Args:
        profile: of a raw image of ``camera``.
        camera: see :func:`triangulate`.
        plane: in the optical frame of the camera.
        config: depth range, and least angle between ray and plane.
    """
    lines, points_px = profile.valid_lines, profile.points_px()
    sines = np.abs(camera_rays(points_px, camera) @ plane.normal)
    points_m = triangulate(points_px, camera, plane)
    limit_m = config.stripe_max_depth or np.inf
    grazing = ~(sines >= np.sin(np.radians(config.min_plane_angle)))
    with np.errstate(invalid="ignore"):
        outside = ~((points_m[:, 2] >= config.stripe_min_depth) & (points_m[:, 2] <= limit_m))
    step = np.array([_STEP_PX, 0.0] if profile.vertical else [0.0, _STEP_PX])
    moved_m = triangulate(points_px + step, camera, plane)
    sigma_m = np.linalg.norm(moved_m - points_m, axis=1) / _STEP_PX * profile.sigma_px[lines]
    for refused, reason in ((grazing, StripeReason.GRAZING), (outside, StripeReason.RANGE)):
        every = np.zeros(len(profile.reasons), bool)
        every[lines[refused]] = True
        profile = profile.rejected(every, reason)
    kept = profile.reasons[lines] == 0
    return ProfilePoints(profile, lines[kept], points_m[kept], sigma_m[kept], profile.level[lines[kept]].astype(float))


def search_range(
    camera: CameraModel,
    plane: LightPlane,
    config: LightStripeConfig,
    near: Callable[[F64], npt.NDArray[np.bool_]] | None = None,
) -> npt.NDArray[np.int32] | None:
    """Where each line of the image may see the light plane in the depth range, int32 (L, 2), last excluded.

    None without any limit. The edges are up to a few pixels outside; lines without such a place are empty.

    Args:
        camera, plane: the light plane in the optical frame of the camera.
        config: depth range.
        near: which of some points, float64 (N, 3), are of interest, bool (N,); None for all.
    """
    if not config.stripe_min_depth and not config.stripe_max_depth and near is None:
        return None
    vertical = config.stripe_direction == "vertical"
    count, length = (camera.height, camera.width) if vertical else (camera.width, camera.height)
    lines = np.unique(np.append(np.arange(0, count, _COARSE_PX), count - 1)).astype(float)
    places = np.unique(np.append(np.arange(0, length, _COARSE_PX), length - 1)).astype(float)
    grid = np.stack(np.meshgrid(places, lines), axis=-1).reshape(-1, 2)
    points_m = triangulate(grid if vertical else grid[:, ::-1].copy(), camera, plane)
    with np.errstate(invalid="ignore"):
        wanted = (points_m[:, 2] >= config.stripe_min_depth) & (points_m[:, 2] <= (config.stripe_max_depth or np.inf))
        wanted &= True if near is None else near(points_m)
    inside = wanted.reshape(len(lines), -1)
    found = inside.any(axis=1)
    first = np.where(found, places[inside.argmax(axis=1)] - _COARSE_PX, 0)
    last = np.where(found, places[inside.shape[1] - 1 - inside[:, ::-1].argmax(axis=1)] + _COARSE_PX + 1, 0)
    nearest = np.abs(lines[None] - np.arange(count)[:, None]).argmin(axis=1)
    edges = np.stack((first, last), axis=1)[nearest]
    return np.asarray(np.clip(edges, 0, length), np.int32)

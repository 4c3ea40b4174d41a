# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic light stripe scans: what two cameras see of a laser's light plane on a moving object, with exact truth."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.synthetic.rays import in_shadow, rays_of, trace
from stereo_depth_ros.synthetic.rig import CENTER_LEFT_RIGHT_M, R_RIGHT_LEFT, synthetic_rig
from stereo_depth_ros.synthetic.scene import Cylinder, Rectangle, Scene, Sphere, Texture

__all__ = ["LASER_M", "PLANE", "SyntheticStripe", "stripe_scene"]

LASER_M = np.array([0.21, -0.05, 0.01])  # of the laser, in the frame of the raw left camera
_NORMAL = np.array([math.cos(math.radians(22.0)), 0.06, math.sin(math.radians(22.0))])
# A, B, C, D of A X + B Y + C Z + D = 0 in that frame
PLANE = np.append(_NORMAL, -_NORMAL @ LASER_M) / np.linalg.norm(_NORMAL)

_LASER_LEVEL = 210.0  # of a white surface that faces the laser, in the middle of the stripe
_COLOR = np.array([0.12, 1.0, 0.3])  # RGB of the laser
_AMBIENT = 0.35  # share of the gray levels of the textures


class SyntheticStripe:
    """Images of a light stripe; equal arguments give equal images.

    Args:
        width, height: size of both images, px; the field of view is the same at all sizes.
        scene: in the frame of the raw left camera, meters.
        plane: float64 (4,), A, B, C, D of the light plane, of any length, in the same frame.
        sigma_m: standard deviation of the stripe across the light plane, meters.
        noise: standard deviation of the noise of the images, gray levels.
        seed: of textures and noise.

    Attributes:
        rig: the cameras.
    """

    def __init__(
        self,
        width: int = 320,
        height: int = 240,
        scene: Scene | None = None,
        plane: npt.ArrayLike = PLANE,
        sigma_m: float = 0.0025,
        noise: float = 1.5,
        seed: int = 7,
    ) -> None:
        self.rig = synthetic_rig(width, height)
        self.plane = np.asarray(plane, np.float64) / np.linalg.norm(np.asarray(plane, np.float64)[:3])
        self._primitives = (scene or stripe_scene(seed)).packed()
        self._sigma_m, self._noise, self._seed = sigma_m, noise, seed
        self._rays = {"left": rays_of(self.rig.left), "right": rays_of(self.rig.right)}

    def capture(self, motion: F64 | None = None, plane_motion: F64 | None = None, number: int = 0) -> tuple[U8, U8]:
        """Left and right raw image, uint8 (H, W, 3) RGB.

        Args:
            motion: float64 (4, 4), rigid motion of the object in the frame of the raw left camera; None for none.
            plane_motion: the same of the light plane.
            number: of the image; each has another noise.
        """
        left = self._image("left", motion, plane_motion, 2 * number)
        return left, self._image("right", motion, plane_motion, 2 * number + 1)

    def depth_m(self, points_px: F64, motion: F64 | None = None) -> F64:
        """True depth at raw pixels, float64 (N, 2), of the left camera, meters, float64 (N,); NaN without a surface."""
        left = self.rig.left
        undistorted = cv2.undistortPoints(
            points_px.reshape(-1, 1, 2), left.K, left.D, None, None, None
        )  # x / z and y / z
        center, rotation = _camera_pose("left", motion)
        points = self._trace(np.ascontiguousarray(undistorted.reshape(1, -1, 2), np.float64), center, rotation)[0][0]
        return np.asarray(((points - center) @ rotation)[:, 2], np.float64)

    def _image(self, side: str, motion: F64 | None, plane_motion: F64 | None, number: int) -> U8:
        center, rotation = _camera_pose(side, motion)
        points, normals, levels = self._trace(self._rays[side], center, rotation)
        to_world = np.identity(4) if motion is None else np.linalg.inv(motion)
        to_world = to_world @ (np.identity(4) if plane_motion is None else plane_motion)
        plane = self.plane @ np.linalg.inv(to_world)
        laser = to_world[:3, :3] @ LASER_M + to_world[:3, 3]
        shadow = np.empty(points.shape[:2], np.bool_)
        run_bands(in_shadow, len(points), self._primitives, points, np.ascontiguousarray(laser), shadow)
        with np.errstate(invalid="ignore"):
            distance = points @ plane[:3] + plane[3]
            sight = laser - points
            cosine = np.abs((sight * normals).sum(axis=-1)) / np.linalg.norm(sight, axis=-1)
            light = np.exp(-0.5 * np.square(distance / self._sigma_m)) * cosine * (levels / 255)
        light[~np.isfinite(light) | shadow] = 0.0
        color = _AMBIENT * levels[..., None] + _LASER_LEVEL * light[..., None] * _COLOR
        height, width = self.rig.height, self.rig.width
        mean = color.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
        random = np.random.default_rng((self._seed, number))
        return np.asarray(np.clip(mean + self._noise * random.normal(size=mean.shape) + 0.5, 0, 255), np.uint8)

    def _trace(self, rays: F64, center: F64, rotation: F64) -> tuple[F64, F64, F64]:
        """Points and normals in the world, and gray levels, of rays, float64 (H, W, 2)."""
        shape = rays.shape[:2]
        points, normals, levels = np.empty((*shape, 3)), np.empty((*shape, 3)), np.empty(shape)
        surface, pixel_rad = np.empty(shape, np.int32), 1.0 / float(self.rig.left.K[0, 0])
        geometry = self._primitives, center, rotation, rays, pixel_rad, self._seed
        run_bands(trace, shape[0], *geometry, points, normals, levels, surface)
        return points, normals, levels


def _camera_pose(side: str, motion: F64 | None) -> tuple[F64, F64]:
    """Center (3,) and rotation (3, 3) to the world of a raw camera: the object stays, the cameras move back."""
    inverse = np.identity(4) if motion is None else np.linalg.inv(motion)
    center, rotation = inverse[:3, 3], inverse[:3, :3]
    if side == "right":
        center, rotation = center + rotation @ CENTER_LEFT_RIGHT_M, rotation @ R_RIGHT_LEFT.T
    return np.ascontiguousarray(center), np.ascontiguousarray(rotation)


def stripe_scene(seed: int, contrast: float = 0.0) -> Scene:
    """A board that is tilted, with a ball and a post before it, half a meter from the camera.

    Args:
        seed: of the textures.
        contrast: of the textures, gray levels. Where the surface changes from dark to bright within a stripe, its
            center is not where the light plane is.
    """
    paint = Texture(190.0, contrast)
    return Scene(
        (
            Rectangle((-0.35, -0.25, 0.56), (0.7, 0.0, 0.06), (0.0, 0.5, -0.02), paint),
            Sphere((-0.02, 0.03, 0.52), 0.07, paint),
            Cylinder((-0.04, -0.2, 0.47), (0.0, 0.12, 0.0), 0.012, paint),
        ),
        seed,
    )

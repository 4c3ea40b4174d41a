# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Refinement of poses while they are used: each range image is registered with the surface fused before it."""

from __future__ import annotations

import statistics
from typing import Any

import numpy as np

from stereo_depth_ros.core.errors import RegistrationError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.registration import OrientedImage, OrientedPoints, register
from stereo_depth_ros.surfaces.volume import SurfaceVolume

__all__ = ["PoseRefinement"]

_BESIDE = 0.1  # of the size of an image, by which a vertex may lie beside it
_FLOOR = 0.1  # of the standard deviation of a vertex, voxels: between grid points the surface is a chord


class PoseRefinement:
    """Registers each image with the surface of a volume (frame to model, as Newcombe et al., KinectFusion, 2011).

    An image starts from the refined pose of the last one, by the motion between both given poses: errors that grow
    slowly stay small, and errors of single poses are not enlarged by the distance from the origin. Where the surfaces
    do not determine a motion or do not fit, the image keeps that start.

    Args:
        volume: the surface; empty before the first image.

    Attributes:
        refined, kept: number of images that were registered, and that kept their start.
    """

    def __init__(self, volume: SurfaceVolume) -> None:
        self._volume = volume
        self._last: tuple[Pose, Pose] | None = None  # given and refined
        self._moved: list[tuple[float, float]] = []
        self.refined = self.kept = 0

    def __call__(self, image: RangeImage, pose: Pose) -> Pose:
        """The pose to use, world_from_camera, of an image that is not fused yet."""
        found = pose
        if self._last is not None and self._volume.block_count:
            given, refined = self._last
            found = self._registered(image, refined @ given.inverse() @ pose, pose)
        self._last = pose, found
        return found

    def _registered(self, image: RangeImage, start: Pose, given: Pose) -> Pose:
        try:
            found = register(OrientedImage.of(image), self._surface(image, start), start).pose
        except RegistrationError:
            self.kept += 1
            return start
        self.refined += 1
        cosine = (np.trace(found.rotation @ given.rotation.T) - 1) / 2
        angle_deg = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        self._moved.append((float(np.linalg.norm(found.translation_m - given.translation_m)), angle_deg))
        return found

    def _surface(self, image: RangeImage, start: Pose) -> OrientedPoints:
        """The vertices that the image may show from about this pose."""
        mesh, t, (width, height) = self._volume.mesh(), image.triangulation, image.size
        x, y, z = start.inverse().apply(mesh.points_m.astype(np.float64)).T
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = t.f_px * x / z + t.cx_px, t.fy_px * y / z + t.cy_px
        seen = (z > 0) & (np.abs(u / width - 0.5) < 0.5 + _BESIDE) & (np.abs(v / height - 0.5) < 0.5 + _BESIDE)
        sigma = np.hypot(mesh.sigma_m[seen], np.float32(_FLOOR * self._volume.voxel_m))
        return OrientedPoints(mesh.points_m[seen], mesh.normals[seen], sigma)

    @property
    def text(self) -> str:
        """What was done, in words."""
        kept = f", {self.kept} kept: their surfaces do not determine a motion, or do not fit" if self.kept else ""
        if not self._moved:
            return f"{self.refined}{kept}"
        shift_m, angle_deg = (statistics.median(values) for values in zip(*self._moved, strict=True))
        return f"{self.refined}, moved by {1e3 * shift_m:.1f} mm and {angle_deg:.2f} degrees (median){kept}"

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain data."""
        return {"refined": self.refined, "refinement_kept": self.kept}

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


class PoseRefinement:
    """Registers each image with the surface of a volume (frame to model, as Newcombe et al., KinectFusion, 2011).

    An image starts at its given pose, moved as the last one was: errors that grow slowly stay small. Where the surfaces
    do not determine a motion or do not fit, the image keeps that start.

    Args:
        volume: the surface; empty before the first image.

    Attributes:
        refined, kept: number of images that were registered, and that kept their start.
    """

    def __init__(self, volume: SurfaceVolume) -> None:
        self._volume = volume
        self._correction = Pose.identity()
        self._moved: list[tuple[float, float]] = []
        self.refined = self.kept = 0

    def __call__(self, image: RangeImage, pose: Pose) -> Pose:
        """The pose to use, world_from_camera, of an image that is not fused yet."""
        if not self._volume.block_count:
            return pose
        mesh, start = self._volume.mesh(), self._correction @ pose
        try:
            surface = OrientedPoints(mesh.points_m, mesh.normals, mesh.sigma_m)
            found = register(OrientedImage.of(image), surface, start).pose
        except RegistrationError:
            self.kept += 1
            return start
        self.refined += 1
        self._correction = found @ pose.inverse()
        cosine = (np.trace(found.rotation @ pose.rotation.T) - 1) / 2
        angle_deg = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        self._moved.append((float(np.linalg.norm(found.translation_m - pose.translation_m)), angle_deg))
        return found

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

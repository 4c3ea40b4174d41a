# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stereo camera moving through a synthetic room: raw pairs with exact disparity, depth and occlusion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, F64, U8, Frame, StereoPair
from stereo_depth_ros.synthetic.rays import SUPERSAMPLING, depth_and_shadow, pixel_rays, render
from stereo_depth_ros.synthetic.rig import (
    CENTER_LEFT_RIGHT_M,
    R_RIGHT_LEFT,
    inside_raw_image,
    product,
    synthetic_rig,
    turn,
)
from stereo_depth_ros.synthetic.scene import Scene, room_scene

__all__ = ["SyntheticFrame", "SyntheticSequence"]

START_NS = 1_700_000_000_000_000_000

_GAINS = (1.0, 0.97)  # two cameras are never equally bright
_NOISE_LEVELS = 1.5  # bound of the triangular noise: standard deviation 0.6 gray levels
_SEED_LIMIT = 2**31


@dataclass(frozen=True)
class SyntheticFrame:
    """A raw pair and the truth for the pixels of its rectified left image.

    Attributes:
        pair: the raw mono8 frames, both with the same stamp.
        truth_disparity_px: float32 (H, W), x_left - x_right of the rectified images, f B / Z + (cx_left - cx_right);
            NaN where the ray meets no surface.
        truth_depth_m: float32 (H, W), Z in the rectified left frame, meters; NaN where the ray meets no surface.
        occluded: bool (H, W), True where there is a surface and the right camera does not see it: something stands in
            between, or the point is outside the right image, raw or rectified.
    """

    pair: StereoPair
    truth_disparity_px: F32
    truth_depth_m: F32
    occluded: npt.NDArray[np.bool_]


class SyntheticSequence(Sequence[SyntheticFrame]):
    """Frames of a moving stereo camera, each rendered when it is asked for.

    Frame i does not depend on how many frames there are. Equal arguments give equal bytes in every run, and on every
    machine whose floating point follows IEEE 754: the kernels use correctly rounded operations only, and the matrices
    they get are rounded to 12 decimals. Sine and cosine of a library that is wrong by more than that would show.

    Args:
        frames: length of the sequence.
        width, height: of all images, pixels; the field of view does not change with them.
        seed: of the textures and of the sensor noise; shapes and path do not depend on it.
        rate_hz: frames a second; the camera's path is one of time.
        scene: what is seen; the room of :func:`room_scene` when None.

    Raises:
        ConfigError: a size or rate that is not above 0, or a seed out of range.
    """

    def __init__(
        self,
        frames: int = 20,
        width: int = 640,
        height: int = 480,
        seed: int = 7,
        rate_hz: float = 10.0,
        scene: Scene | None = None,
    ) -> None:
        for name, value in (("frames", frames), ("width", width), ("height", height), ("rate_hz", rate_hz)):
            if not value > 0:
                raise ConfigError(f"synthetic sequence: {name} = {value} is not above 0: set a positive number")
        if not 0 <= seed < _SEED_LIMIT:
            raise ConfigError(f"synthetic sequence: seed = {seed} is outside 0..{_SEED_LIMIT - 1}: set it inside")
        self.rig = synthetic_rig(width, height)
        self.scene = scene or room_scene(seed)
        self.seed = seed
        self.rate_hz = rate_hz
        self._frames = frames
        self._primitives = self.scene.packed()
        self._rays = tuple(_rays(camera) for camera in (self.rig.left, self.rig.right))

    def __len__(self) -> int:
        return self._frames

    @overload
    def __getitem__(self, index: int) -> SyntheticFrame: ...
    @overload
    def __getitem__(self, index: slice) -> list[SyntheticFrame]: ...
    def __getitem__(self, index: int | slice) -> SyntheticFrame | list[SyntheticFrame]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        i = range(len(self))[index]
        depth_m, occluded = self._truth(i)
        disparity_px = self.rig.f_px * self.rig.baseline_m / depth_m + self.rig.doffs_px
        return SyntheticFrame(self._pair(i), disparity_px.astype(np.float32), depth_m.astype(np.float32), occluded)

    def stamp_ns(self, index: int) -> int:
        """Time of frame ``index``, integer nanoseconds."""
        return START_NS + round(index * 1_000_000_000 / self.rate_hz)

    def pose(self, index: int) -> tuple[F64, F64]:
        """Where the raw left camera is: R_world_left, float64 (3, 3), and its center in the world, float64 (3,) m."""
        t = index / self.rate_hz
        R_left_world = turn(0.07 * math.sin(0.6 * t), -0.01, 0.004)
        center = [0.25 * math.sin(0.9 * t), 0.03 * math.sin(1.7 * t), 0.25 - 0.25 * math.cos(0.8 * t)]
        return np.ascontiguousarray(R_left_world.T), np.round(center, 12)

    def _right_pose(self, index: int) -> tuple[F64, F64]:
        R_world_left, center = self.pose(index)
        return product(R_world_left, R_RIGHT_LEFT.T), center + product(R_world_left, CENTER_LEFT_RIGHT_M)

    def _pair(self, index: int) -> StereoPair:
        left = self._image(0, index, *self.pose(index))
        right = self._image(1, index, *self._right_pose(index))
        stamp_ns = self.stamp_ns(index)
        return StereoPair(
            Frame(left, stamp_ns, self.rig.left.frame_id), Frame(right, stamp_ns, self.rig.right.frame_id)
        )

    def _image(self, side: int, index: int, rotation: F64, center: F64) -> U8:
        image = np.empty((self.rig.height, self.rig.width), np.uint8)
        pixel_rad = 1.0 / float(self.rig.left.K[0, 0])
        noise_seed = (self.seed << 32) + 2 * index + side
        what = (self._primitives, center, rotation, self._rays[side])
        how = (pixel_rad, _GAINS[side], _NOISE_LEVELS, self.scene.seed, noise_seed)
        run_bands(render, len(image), *what, *how, image)
        return image

    def _truth(self, index: int) -> tuple[F64, npt.NDArray[np.bool_]]:
        left, shape = self.rig.left, (self.rig.height, self.rig.width)
        depth_m, shadow = np.empty(shape), np.empty(shape, np.bool_)
        R_world_left, center = self.pose(index)
        R_world_rectified = product(R_world_left, left.R.T)
        what = (self._primitives, center, R_world_rectified, left.P, self._right_pose(index)[1])
        run_bands(depth_and_shadow, shape[0], *what, depth_m, shadow)
        return depth_m, shadow | (np.isfinite(depth_m) & ~self._in_right_images(depth_m))

    def _in_right_images(self, depth_m: F64) -> npt.NDArray[np.bool_]:
        """Whether each left pixel's point projects into the right image, rectified and raw."""
        rig = self.rig
        y, x = np.indices(depth_m.shape)
        x_m, y_m = (x - rig.cx_left) / rig.f_px * depth_m, (y - rig.cy) / rig.fy_px * depth_m
        x_right = (x_m - rig.baseline_m) * rig.f_px / depth_m + rig.cx_right
        in_raw = inside_raw_image(rig.right, np.stack([x_m - rig.baseline_m, y_m, depth_m], axis=-1))
        seen: npt.NDArray[np.bool_] = (x_right >= 0) & (x_right <= rig.width - 1) & in_raw
        return seen


def _rays(camera: CameraModel) -> F64:
    rays = np.empty((SUPERSAMPLING * camera.height, SUPERSAMPLING * camera.width, 2))
    run_bands(pixel_rays, len(rays), camera.K, camera.D, rays)
    return rays

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic sequences: raw pairs of a moving stereo rig with exact disparity, depth and occlusion."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, F64, U8, Frame, StereoPair
from stereo_depth_ros.synthetic.rays import depth_and_shadow, rays_of, render
from stereo_depth_ros.synthetic.rig import (
    CENTER_LEFT_RIGHT_M,
    R_RIGHT_LEFT,
    inside_raw_image,
    product,
    rotation_into,
    synthetic_rig,
)
from stereo_depth_ros.synthetic.scene import Scene, room_scene

__all__ = ["SyntheticFrame", "SyntheticSequence"]

START_NS = 1_700_000_000_000_000_000

_GAINS = (1.0, 0.97)  # of the left and the right camera
_NOISE_LEVELS = 1.5  # largest value of the triangular noise, whose standard deviation is 0.6 gray levels
_SEED_LIMIT = 2**31


@dataclass(frozen=True)
class SyntheticFrame:
    """A raw pair with the truth of its rectified left image.

    Attributes:
        pair: the raw mono8 frames, both with the same stamp.
        truth_disparity_px: float32 (H, W), x_left - x_right of the rectified images in pixels,
            f B / Z + (cx_left - cx_right); NaN without a surface.
        truth_depth_m: float32 (H, W), Z in the rectified left frame, meters; NaN without a surface.
        occluded: bool (H, W), true where the right camera does not see the surface: another one is in between, or the
            point is outside of the right image, raw or rectified.
    """

    pair: StereoPair
    truth_disparity_px: F32
    truth_depth_m: F32
    occluded: npt.NDArray[np.bool_]


class SyntheticSequence(Sequence[SyntheticFrame]):
    """Frames of a moving stereo rig, each rendered on access.

    Frame i does not depend on the number of frames. Equal arguments give equal bytes in every run and on every machine
    with IEEE 754 arithmetic: the kernels use only correctly rounded operations, and their matrices are rounded to 12
    decimals, which hides smaller differences between implementations of sine and cosine.

    Args:
        frames: number of frames.
        width, height: size of all images, pixels; the field of view is the same at all sizes.
        seed: seed of the textures and of the sensor noise; shapes and motion do not depend on it.
        rate_hz: frames per second; the motion is a function of time.
        scene: the scene to render; None uses :func:`room_scene`.

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
                raise ConfigError(
                    f"{name} = {value} is not above 0",
                    subject="synthetic sequence",
                    value=value,
                    limit=0,
                    remedy="set a positive number",
                    settings=(name,),
                )
        if not 0 <= seed < _SEED_LIMIT:
            raise ConfigError(
                f"seed = {seed} is outside 0..{_SEED_LIMIT - 1}",
                subject="synthetic sequence",
                value=seed,
                limit=(0, _SEED_LIMIT - 1),
                remedy="set a seed in this range",
                settings=("seed",),
            )
        self.rig = synthetic_rig(width, height)
        self.scene = scene or room_scene(seed)
        self.seed = seed
        self.rate_hz = rate_hz
        self._frames = frames
        self._primitives = self.scene.packed()

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
        """Stamp of frame ``index``, integer nanoseconds."""
        return START_NS + round(index * 1_000_000_000 / self.rate_hz)

    def pose(self, index: int) -> tuple[F64, F64]:
        """Pose of the raw left camera: R_world_left, float64 (3, 3), and its center in the world, float64 (3,), m."""
        t = index / self.rate_hz
        R_left_world = rotation_into(0.07 * math.sin(0.6 * t), -0.01, 0.004)
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

    @functools.cached_property
    def _rays(self) -> tuple[F64, F64]:
        return rays_of(self.rig.left), rays_of(self.rig.right)

    def _image(self, side: int, index: int, rotation: F64, center: F64) -> U8:
        image = np.empty((self.rig.height, self.rig.width), np.uint8)
        pixel_rad = 1.0 / float(self.rig.left.K[0, 0])
        noise_seed = (self.seed << 32) + 2 * index + side
        geometry = (self._primitives, center, rotation, self._rays[side])
        appearance = (pixel_rad, _GAINS[side], _NOISE_LEVELS, self.scene.seed, noise_seed)
        run_bands(render, len(image), *geometry, *appearance, image)
        return image

    def _truth(self, index: int) -> tuple[F64, npt.NDArray[np.bool_]]:
        left, shape = self.rig.left, (self.rig.height, self.rig.width)
        depth_m, shadow = np.empty(shape), np.empty(shape, np.bool_)
        R_world_left, center = self.pose(index)
        R_world_rectified = product(R_world_left, left.R.T)
        geometry = (self._primitives, center, R_world_rectified, left.P, self._right_pose(index)[1])
        run_bands(depth_and_shadow, shape[0], *geometry, depth_m, shadow)
        return depth_m, shadow | (np.isfinite(depth_m) & ~self._in_right_images(depth_m))

    def _in_right_images(self, depth_m: F64) -> npt.NDArray[np.bool_]:
        """Whether the point of each left pixel projects into the right image, rectified and raw."""
        rig = self.rig
        y, x = np.indices(depth_m.shape)
        x_m, y_m = (x - rig.cx_left) / rig.f_px * depth_m, (y - rig.cy) / rig.fy_px * depth_m
        x_right = (x_m - rig.baseline_m) * rig.f_px / depth_m + rig.cx_right
        in_raw = inside_raw_image(rig.right, np.stack([x_m - rig.baseline_m, y_m, depth_m], axis=-1))
        visible: npt.NDArray[np.bool_] = (x_right >= 0) & (x_right <= rig.width - 1) & in_raw
        return visible

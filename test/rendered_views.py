# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectified images of the synthetic room, of both cameras and of any camera on the line through them."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.synthetic.rays import SUPERSAMPLING, pixel_rays, render
from stereo_depth_ros.synthetic.rig import CENTER_LEFT_RIGHT_M, product
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

__all__ = ["Views", "psnr", "rendered_views"]


class Views(NamedTuple):
    """Rectified images uint8 (H, W) without noise, and the true disparities of the left one, float32 (H, W)."""

    sequence: SyntheticSequence
    left: U8
    right: U8
    disparity_px: F32

    def at(self, position: float) -> U8:
        """The image of the camera at ``position``, rendered."""
        return _image(self.sequence, position)


@functools.cache
def rendered_views(width: int = 240, height: int = 180) -> Views:
    """The room of the sample bag in a small size."""
    sequence = SyntheticSequence(1, width, height)
    return Views(sequence, _image(sequence, 0.0), _image(sequence, 1.0), sequence[0].truth_disparity_px)


def psnr(image: U8, truth: U8) -> float:
    """Peak signal-to-noise ratio of two images of 8 bits, dB."""
    return float(10 * np.log10(255**2 / np.mean((image.astype(np.float64) - truth) ** 2)))


def _image(sequence: SyntheticSequence, position: float) -> U8:
    rig = sequence.rig
    rays: F64 = np.empty((SUPERSAMPLING * rig.height, SUPERSAMPLING * rig.width, 2))
    K = rig.left.P[:, :3].copy()
    K[0, 2] = (1 - position) * rig.cx_left + position * rig.cx_right
    run_bands(pixel_rays, len(rays), K, np.zeros(5), rays)
    R_world_left, center = sequence.pose(0)
    origin = center + position * product(R_world_left, CENTER_LEFT_RIGHT_M)
    camera = (sequence.scene.packed(), origin, product(R_world_left, rig.left.R.T), rays)
    image = np.empty((rig.height, rig.width), np.uint8)
    run_bands(render, rig.height, *camera, 1 / rig.f_px, 1.0, 0.0, sequence.scene.seed, 0, image)
    return image

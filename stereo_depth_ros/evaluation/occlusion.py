# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Occlusion from the true disparities of the left image: the pixels that both cameras see."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.types import F32

__all__ = ["visible_pixels"]

# Neighbors on a surface whose disparity rises by up to 1/2 px a pixel differ by less where they share a right pixel.
_OCCLUDER_STEP_PX = 1.0


def visible_pixels(truth_px: F32) -> npt.NDArray[np.bool_]:
    """Pixels of the left image that the right camera sees too.

    The truth is warped to the nearest pixels of the right image. A pixel is occluded if another one of its row maps to
    the same right pixel with a disparity that is larger by at least 1 px, or if it maps outside of the right image.
    Surfaces of unknown truth occlude nothing.

    Args:
        truth_px: float32 (H, W), x_left - x_right in pixels, not finite where unknown.

    Returns:
        bool (H, W); false where the truth is unknown.
    """
    height, width = truth_px.shape
    known = np.isfinite(truth_px)
    truth = np.where(known, truth_px, np.float32(0))
    at = np.rint(np.arange(width, dtype=np.float32) - truth).astype(np.int64)
    inside = known & (at >= 0) & (at < width)
    rows = np.broadcast_to(np.arange(height)[:, None], at.shape)
    nearest = np.full((height, width), -np.inf, np.float32)
    np.maximum.at(nearest, (rows[inside], at[inside]), truth[inside])
    hidden = nearest[rows, at.clip(0, width - 1)] - truth >= _OCCLUDER_STEP_PX
    return np.asarray(inside & ~hidden)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Wiggle animations: depth from the motion of the camera between left and right, without glasses."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.views.convergence import common_columns
from stereo_depth_ros.views.interpolation import interpolate_view

__all__ = ["FRAME_MS", "wiggle"]

FRAME_MS = 80
_POSITIONS = (0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25)


def wiggle(left: U8, right: U8, disparity_px: F32, shift_px: int) -> list[U8]:
    """Frames of a loop from the left camera to the right one and back, which turns around the subject.

    Args:
        left, right: uint8 (H, W) or (H, W, 3), rectified.
        disparity_px: float32 (H, W), NaN where invalid.
        shift_px: disparity of the subject, which stays in its place, whole pixels.

    Returns:
        8 frames of the columns that both images have, |shift_px| fewer than these.

    Raises:
        ImageError: the sizes differ.
        ConfigError: the shift leaves no columns.
    """
    first, last = common_columns(left.shape[1], shift_px)
    if first >= last:
        raise ConfigError(
            f"convergence of {shift_px} px leaves none of the {left.shape[1]} columns",
            value=shift_px,
            limit=left.shape[1] - 1,
            remedy="set it between the disparities of the scene",
            settings=("convergence",),
        )
    frames = []
    for position in _POSITIONS:
        view = interpolate_view(left, right, disparity_px, position)
        offset = shift_px // 2 - round(position * shift_px)
        frames.append(np.ascontiguousarray(view[:, first + offset : last + offset]))
    return frames

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Why pixels have no disparity, as colors."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from stereo_depth_ros.core.types import U8, Reason

__all__ = ["REASON_COLORS", "VALID_DIMMED", "reason_colors"]

# BGR, apart in lightness too; of several reasons of a pixel the first here is shown
REASON_COLORS: Mapping[Reason, tuple[int, int, int]] = MappingProxyType(
    {
        Reason.BORDER: (110, 110, 110),
        Reason.RANGE: (200, 90, 160),
        Reason.SHADOW: (120, 60, 40),
        Reason.TEXTURE: (170, 200, 60),
        Reason.UNIQUENESS: (60, 190, 250),
        Reason.LEFT_RIGHT: (80, 80, 235),
        Reason.SPECKLE: (230, 240, 250),
        Reason.NO_MATCH: (40, 130, 70),
    }
)
VALID_DIMMED = 0.4  # gray levels of pixels with a disparity, in parts of those of the image


def reason_colors(reasons: U8, left: U8) -> U8:
    """The left image, dimmed, with the pixels that have no disparity in the color of their reason.

    Args:
        reasons: uint8 (H, W), bits of :class:`Reason`.
        left: uint8 (H, W), gray.

    Returns:
        uint8 (H, W, 3), BGR.
    """
    table = np.zeros((256, 3), np.uint8)
    for reason, color in [*REASON_COLORS.items()][::-1]:
        table[(np.arange(256) & reason.value) != 0] = color
    dimmed = np.rint(VALID_DIMMED * np.arange(256)).astype(np.uint8)[left]
    return np.where(reasons[..., None] == 0, dimmed[..., None], table[reasons])

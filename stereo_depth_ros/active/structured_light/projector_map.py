# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Projector map: the projector pixel that lights each pixel of a camera."""

from __future__ import annotations

from dataclasses import dataclass

from stereo_depth_ros.core.types import F32, U8

__all__ = ["ProjectorMap"]


@dataclass(frozen=True, eq=False)
class ProjectorMap:
    """What a camera sees of a projector, decoded from a sequence of patterns.

    Attributes:
        size: width, height of the projector, px.
        column_px, row_px: float32 (H, W), projector px, whose centers have integer coordinates; NaN where not decoded.
            One of them is None where the patterns do not code it.
        sigma_px: float32 (H, W), standard deviation of the coded coordinates, projector px; NaN where not decoded.
        reasons: uint8 (H, W), bits of :class:`~stereo_depth_ros.core.types.Reason`, 0 exactly where every coded
            coordinate is finite: SHADOW where the projector does not light the point, TEXTURE where its light is too
            weak or the pixel is saturated, UNIQUENESS where the code is doubtful, NO_MATCH where no pixel has it.
    """

    size: tuple[int, int]
    column_px: F32 | None
    row_px: F32 | None
    sigma_px: F32
    reasons: U8

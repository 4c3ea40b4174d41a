# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stripe profile: where a light stripe crosses each line of an image, how exactly, and why it is not found."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from stereo_depth_ros.core.types import F32, F64, U8

__all__ = ["StripeProfile", "StripeReason"]

_JUMP_PX = 4.0  # from line to line; the steepest stripe that is accepted moves by less


class StripeReason(enum.IntFlag):
    """Why a line of the image has no point; bits of uint8, 0 where it has one."""

    VALID = 0
    NO_STRIPE = 1  # nothing narrow stands out of the noise
    TWO_STRIPES = 2  # two of similar contrast
    SATURATED = 4  # saturated over more than the width of the stripe: its center is not seen
    WIDE = 8  # wider than three times the expected width, or nearly along the line
    GRAZING = 16  # the ray is nearly parallel to the light plane
    RANGE = 32  # outside the depth range, not in front of the camera, or too far from the axis of a turntable
    DISAGREEMENT = 64  # light plane and second camera give different points
    SPECKLE = 128  # a piece of too few lines


@dataclass(frozen=True, eq=False)
class StripeProfile:
    """A light stripe in one image: one place a line, which is a row where the stripe is vertical, else a column.

    Attributes:
        position_px: float32 (L,), sub-pixel place along each line, px; NaN where there is none.
        sigma_px: float32 (L,), its standard deviation by the noise of the image, px; NaN where there is none.
        level: float32 (L,), signal at the stripe, gray levels; NaN where no stripe was found.
        width_px: float32 (L,), full width of the stripe at half its height, px; NaN where no stripe was found.
        reasons: uint8 (L,), bits of :class:`StripeReason`, 0 exactly where there is a place.
        vertical: whether the lines are rows.
    """

    position_px: F32
    sigma_px: F32
    level: F32
    width_px: F32
    reasons: U8
    vertical: bool

    @property
    def valid_lines(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Numbers of the lines that have a place, int64 (N,)."""
        return np.flatnonzero(self.reasons == 0)

    def points_px(self) -> F64:
        """The places in the image, float64 (N, 2), columns x, y, one for each of :attr:`valid_lines`."""
        lines = self.valid_lines
        along = self.position_px[lines].astype(np.float64)
        return np.column_stack((along, lines) if self.vertical else (lines, along)).astype(np.float64)

    def rejected(self, refused: np.ndarray[tuple[int], np.dtype[np.bool_]], reason: StripeReason) -> StripeProfile:
        """The profile without some lines.

        Args:
            refused: bool (L,), lines that lose their place; others that have none keep their reasons.
            reason: why.
        """
        lost = refused & (self.reasons == 0)
        return StripeProfile(
            np.where(lost, np.float32(np.nan), self.position_px),
            np.where(lost, np.float32(np.nan), self.sigma_px),
            self.level,
            self.width_px,
            np.where(lost, np.uint8(reason), self.reasons).astype(np.uint8),
            self.vertical,
        )

    def without_speckles(self, least: int) -> StripeProfile:
        """The profile without pieces of fewer than ``least`` lines; a piece ends at a gap, or a jump of its place."""
        lines = self.valid_lines
        if least <= 1 or not len(lines):
            return self
        breaks = (np.diff(lines) > 1) | (np.abs(np.diff(self.position_px[lines])) > _JUMP_PX)
        piece = np.concatenate(([0], np.cumsum(breaks)))
        refused = np.zeros(len(self.reasons), bool)
        refused[lines[np.bincount(piece)[piece] < least]] = True
        return self.rejected(refused, StripeReason.SPECKLE)

    def reason_counts(self) -> dict[str, int]:
        """Number of lines for each reason."""
        return {str(r.name): int(np.count_nonzero(self.reasons & r.value)) for r in StripeReason if r.value}

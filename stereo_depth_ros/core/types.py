# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The words everything is said in: what goes into the path and what comes out of it."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["F32", "F64", "U8", "Frame", "MatchResult", "Reason", "RectifiedPair", "StereoPair"]

U8: TypeAlias = npt.NDArray[np.uint8]
F32: TypeAlias = npt.NDArray[np.float32]
F64: TypeAlias = npt.NDArray[np.float64]


class Reason(enum.IntFlag):
    """Why a pixel has no disparity; bits of the uint8 reason map, 0 where the pixel is valid."""

    VALID = 0
    NO_MATCH = 1  # the matcher rejected the pixel and does not say more
    LEFT_RIGHT = 2  # left-right check: the right image prefers another left pixel
    UNIQUENESS = 4  # a second disparity is nearly as good
    TEXTURE = 8  # not enough texture in the window
    SPECKLE = 16  # small isolated component
    RANGE = 32  # not in front of the cameras: no positive finite depth
    BORDER = 64  # the search or the window leaves the image


@dataclass(frozen=True)
class Frame:
    """One decoded image of one camera.

    Attributes:
        pixels: uint8, (H, W) grey or (H, W, 3) colour in the order that ``encoding`` names.
        stamp_ns: time of the exposure, integer nanoseconds (the header stamp).
        frame_id: name of the optical frame.
        encoding: "mono8", "rgb8" or "bgr8".
    """

    pixels: U8
    stamp_ns: int
    frame_id: str
    encoding: str = "mono8"


@dataclass(frozen=True)
class StereoPair:
    """Left and right frame that belong together. Raw (unrectified) or rectified: the stage that takes it says which."""

    left: Frame
    right: Frame


@dataclass(frozen=True)
class RectifiedPair:
    """Rows aligned: a point has the same row in both images.

    Attributes:
        left, right: uint8 (H, W), grey, what the matcher sees.
        left_color: uint8 (H, W) or (H, W, 3), the rectified left image as it came, what colours the cloud.
        color_encoding: encoding of ``left_color``: "mono8", "rgb8" or "bgr8".
    """

    left: U8
    right: U8
    left_color: U8
    color_encoding: str


@dataclass(frozen=True)
class MatchResult:
    """What a matcher returns, or the disparity stage, which takes more out.

    A snapshot: no later call changes it, unless a buffer that the caller gave for ``disparity_px`` is used again; the
    confidence does not change even then. Without such a buffer, ask for the confidence before writing into the arrays.

    Attributes:
        disparity_px: float32 (H, W), x_left - x_right in pixels, NaN where invalid.
        reasons: uint8 (H, W), bits of :class:`Reason`, 0 exactly where ``disparity_px`` is finite.
        step_px: smallest difference between two disparities this matcher can tell (1/16 for OpenCV's).
        confidence_source: the confidence, or what computes it when it is asked for; None from a method without one.
    """

    disparity_px: F32
    reasons: U8
    step_px: float
    confidence_source: F32 | Callable[[], F32] | None = None

    @cached_property
    def confidence(self) -> F32 | None:
        """How far each disparity can be trusted, float32 (H, W) in [0, 1], 0 where there is none or one was filled in.

        Computed when it is first asked for, of the disparities in this result. What the disparity stage took out has
        none; to methods that count the neighbors that agree it is a hole, which supports nobody. Confidences that a
        method gives as an array stay as they are elsewhere.
        """
        source = self.confidence_source
        confidence = source() if callable(source) else source
        return None if confidence is None else np.where(self.reasons == 0, confidence, np.float32(0))

    @property
    def valid_fraction(self) -> float:
        """Share of pixels that have a disparity, 0..1."""
        return float(np.count_nonzero(self.reasons == 0)) / self.reasons.size

    def reason_counts(self) -> dict[str, int]:
        """Number of pixels per reason name (a pixel may have several)."""
        counts = np.bincount(self.reasons.ravel(), minlength=256)
        values = np.arange(256)
        return {str(r.name): int(counts[(values & r.value) != 0].sum()) for r in Reason if r.value}

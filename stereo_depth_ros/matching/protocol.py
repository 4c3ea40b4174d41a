# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Protocol of the matchers, and the checks of their input."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeAlias

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.config.matchers import matchers_with
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8, MatchResult

__all__ = ["Images", "Matcher", "check_buffer", "check_images", "check_pair", "check_search"]

Images: TypeAlias = tuple[U8, U8]  # left and right

# Disparities are 16-bit integers in steps of 1/16 px, as in OpenCV; one whole pixel is reserved for "invalid".
X16_STEPS = 16
LOWEST_DISPARITY = -2047
HIGHEST_DISPARITY = 2047


class Matcher(Protocol):
    """A stereo matching method. It keeps buffers between frames: concurrent calls are serialized."""

    @property
    def name(self) -> str:
        """Name for :func:`~stereo_depth_ros.matching.create_matcher`."""

    @property
    def config(self) -> MatchingConfig:
        """The parameters; they do not change."""

    @property
    def step_px(self) -> float:
        """Resolution of the disparities, px."""

    @property
    def uses_one_core(self) -> bool:
        """Whether it spends most of its time in one thread, so that several of them match different pairs at once."""

    @property
    def support_px(self) -> tuple[int, int]:
        """Width and height, odd, px, of the window of a matching cost, without prefilters or smoothing."""

    @property
    def pair_count(self) -> int:
        """Number of pairs of a sequence, the newest ones, that it matches together; 1 for a method of single pairs."""

    @property
    def engine(self) -> str:
        """What runs its network, for the log; empty for a method without one."""

    @property
    def takes_prior(self) -> bool:
        """Whether it uses the disparities that another sensor expects."""

    def match(
        self,
        left: U8,
        right: U8,
        out: F32 | None = None,
        earlier: Sequence[Images] = (),
        prior: DisparityPrior | None = None,
    ) -> MatchResult:
        """Disparities of the left image. They depend on the arguments alone, not on the calls before.

        Args:
            left, right: uint8 (H, W), rectified gray: a point has the same row in both.
            out: float32 (H, W), C-contiguous, becomes ``disparity_px`` of the result; None allocates it. It receives a
                copy, so that it can be reused while results are kept for their confidence.
            earlier: the pairs before this one, the oldest first, of the same size; the last ``pair_count`` - 1 of them
                are used. With fewer, the pairs that there are are matched together.
            prior: disparities that another sensor expects in the left image, of its size; None without.

        Raises:
            ImageError: wrong dtype or shape, or too small for the window and the search range.
            ConfigError: a prior, which the method does not take.
        """


def check_search(config: MatchingConfig) -> None:
    """Raise ConfigError if the search range does not fit in 16-bit steps of 1/16 px."""
    if config.min_disparity < LOWEST_DISPARITY or config.max_disparity > HIGHEST_DISPARITY:
        raise ConfigError(
            f"disparities {config.min_disparity}..{config.max_disparity} are searched, but only "
            f"{LOWEST_DISPARITY}..{HIGHEST_DISPARITY} can be stored",
            value=(config.min_disparity, config.max_disparity),
            limit=(LOWEST_DISPARITY, HIGHEST_DISPARITY),
            remedy="use a smaller search range",
            settings=("min_disparity", "disparity_range"),
        )


def check_images(left: U8, right: U8) -> None:
    """Raise ImageError if the images are not two uint8 (H, W) of one size."""
    for side, image in (("left", left), ("right", right)):
        if image.dtype != np.uint8 or image.ndim != 2:
            raise ImageError(
                f"{side} image is {image.dtype} of shape {image.shape}, matching takes uint8 (H, W)",
                value=(str(image.dtype), image.shape),
                limit="uint8 (H, W)",
                remedy="convert it to gray",
            )
    if left.shape != right.shape:
        raise ImageError(
            f"left image is {left.shape}, right image is {right.shape}",
            value=right.shape,
            limit=left.shape,
            remedy="both must have one size",
        )


def check_pair(left: U8, right: U8, matcher: Matcher, partial: bool = False) -> None:
    """Raise ImageError if the images are not two uint8 (H, W) of one size, large enough for window and search range.

    Args:
        left, right: the images.
        matcher: its support is the window.
        partial: the method accepts pixels with only part of the range in the right image: one disparity is enough.
    """
    check_images(left, right)
    config, (window_width, window_height) = matcher.config, matcher.support_px
    height, width = left.shape
    nearest = max(config.min_disparity, -config.max_disparity, 0)
    if partial and height and width > nearest:
        return
    need = window_width + max(0, config.max_disparity) + max(0, -config.min_disparity)
    if width < need or height < window_height:
        window = "correlation_window_size"
        adjustable = matcher.name in matchers_with(window)
        raise ImageError(
            f"images of {width} x {height} px (width x height), but a window of {window_width} x {window_height} px "
            f"searched over disparities {config.min_disparity}..{config.max_disparity} needs "
            f"{need} x {window_height} px",
            value=(width, height),
            limit=(need, window_height),
            remedy=f"use a smaller search range{' or window' * adjustable}, or larger images",
            settings=("disparity_range", window) if adjustable else ("disparity_range",),
        )


def check_buffer(out: F32, shape: tuple[int, ...]) -> None:
    """Raise ImageError if ``out`` cannot hold the disparities of images of ``shape``."""
    if out.dtype != np.float32 or out.shape != shape or not out.flags.c_contiguous or not out.flags.writeable:
        raise ImageError(
            f"disparity buffer is {out.dtype} of shape {out.shape}, it must be writeable C-contiguous float32 "
            f"of shape {shape}",
            value=(str(out.dtype), out.shape),
            limit=("float32", shape),
            remedy="pass such an array or None",
        )

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is roughly known of a pair before it is matched: by the pair at a quarter of its size, or by the pair before."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Protocol

import cv2
import numba
import numpy as np
from numba import float32, int64

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.matching.costs.windows import Windows
from stereo_depth_ros.matching.protocol import Matcher
from stereo_depth_ros.matching.sgm.search_windows import changed_tiles, windows_around

__all__ = ["PreviousDisparities", "SearchPrior", "SmallPair"]

SCALE = 4  # of the small pair
MARGIN_PX = 8  # around disparities that are known, for those between them and their errors
REACH_PX, MOTION_PX = 16, 32  # around a tile; of the pair before more, as it has moved


class SearchPrior(Protocol):
    """Windows of the search range for a pair."""

    def windows(self, left: U8, right: U8, whole: Windows, both: bool) -> tuple[Windows, Windows]:
        """Those of the left image, and of the mirrored right one if ``both``; ``whole`` where nothing is known."""
        ...

    def note(self, left: U8, disparity_px: F32) -> None:
        """The result of the pair, float32 (H, W), NaN where invalid."""
        ...


class SmallPair:
    """Disparities of the pair at a quarter of its width and height.

    What is thinner than some 12 px and far in front of its background is not seen there, and not found.

    Windows as those of hierarchical matching (Rothermel, Wenzel, Fritsch and Haala, "SURE: Photogrammetric surface
    reconstruction from imagery", 2012), for tiles instead of pixels, in whole vectors.

    Args:
        config: that of the pair.
        create: makes the matcher of the small pair.
    """

    def __init__(self, config: MatchingConfig, create: Callable[[MatchingConfig], Matcher]) -> None:
        self._config = config
        lowest = math.floor(config.min_disparity / SCALE)
        count = math.ceil((config.max_disparity + 1) / SCALE) - lowest
        self._matcher = create(
            dataclasses.replace(
                config,
                quality="fast",
                search_prior="none",
                disparity_filter="none",
                fill_gaps_px=0,
                fill_holes=False,
                sgm_paths=0,
                sgm_P1=0,
                sgm_P2=0,
                min_disparity=lowest,
                num_disparities=max(32, 16 * math.ceil(count / 16)),
                speckle_size=min(config.speckle_size, 30),
            )
        )

    def windows(self, left: U8, right: U8, whole: Windows, both: bool) -> tuple[Windows, Windows]:
        """See :class:`SearchPrior`."""
        if left.shape[1] // SCALE <= abs(self._matcher.config.max_disparity):
            return whole, whole
        known = self._matcher.match(_quarter(left), _quarter(right)).disparity_px
        config = self._config
        given = left.shape, config.max_disparity, config.num_disparities, MARGIN_PX, REACH_PX
        of_left = windows_around(known, SCALE, *given)
        return of_left, windows_around(_of_mirrored(known), SCALE, *given) if both else whole

    def note(self, left: U8, disparity_px: F32) -> None:
        """Nothing is kept."""


class PreviousDisparities:
    """Disparities of the pair before; where its gray levels have changed by much, the whole range is searched.

    The first pair, and each one of another size, is searched as a whole.
    """

    def __init__(self, config: MatchingConfig) -> None:
        self._config = config
        self._before: tuple[U8, F32] | None = None

    def windows(self, left: U8, right: U8, whole: Windows, both: bool) -> tuple[Windows, Windows]:
        """See :class:`SearchPrior`."""
        if self._before is None or self._before[0].shape != left.shape:
            return whole, whole
        before, known = self._before
        config = self._config
        given = left.shape, config.max_disparity, config.num_disparities, MARGIN_PX, MOTION_PX
        of_left = changed_tiles(left, before, windows_around(known, 1, *given), whole)
        # A change of the left image is one of the right one, somewhere on the same rows: not followed there
        return of_left, windows_around(_of_mirrored(known), 1, *given) if both else whole

    def note(self, left: U8, disparity_px: F32) -> None:
        """See :class:`SearchPrior`."""
        self._before = left.copy(), disparity_px.copy()


def _quarter(image: U8) -> U8:
    """The means of 4 x 4 pixels; the last ones are repeated to a whole number of them."""
    height, width = image.shape
    bottom, right = -height % SCALE, -width % SCALE
    if bottom or right:
        image = np.asarray(cv2.copyMakeBorder(image, 0, bottom, 0, right, cv2.BORDER_REPLICATE), np.uint8)
    size = image.shape[1] // SCALE, image.shape[0] // SCALE
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _of_mirrored(disparity_px: F32) -> F32:
    """The disparities of the mirrored right image, NaN where no left pixel is seen; of several the nearest."""
    mirrored = np.full_like(disparity_px, np.nan)
    _mirror(0, len(disparity_px), disparity_px, mirrored)
    return mirrored


@compiled(numba.void(int64, int64, float32[:, ::1], float32[:, ::1]), allocates=False)
def _mirror(first: int, last: int, disparity_px: F32, mirrored: F32) -> None:
    width = disparity_px.shape[1]
    for y in range(first, last):
        for x in range(width):
            d = disparity_px[y, x]
            if np.isnan(d):
                continue
            at = width - 1 - (x - np.int64(np.rint(d)))
            if 0 <= at < width and not mirrored[y, at] >= d:
                mirrored[y, at] = d

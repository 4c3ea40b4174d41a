# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global block matching with the results of OpenCV's StereoSGBM."""

from __future__ import annotations

import functools
import itertools
import math
from typing import TypeAlias

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import U8, MatchResult, Reason
from stereo_depth_ros.matching.filters.speckle_filter import SpeckleFilter, disparity_from_x16
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair, check_search
from stereo_depth_ros.matching.serial import SerialMatcher
from stereo_depth_ros.matching.sgm.block_costs import I16
from stereo_depth_ros.matching.sgm.block_paths import BlockScratch, BlockSearch, match_blocks

__all__ = ["SemiGlobalBlockMatcher", "penalties"]

Stripe: TypeAlias = tuple[int, int, int]  # rows: where its paths begin, first, last exclusive

MODES = (
    cv2.STEREO_SGBM_MODE_SGBM,
    cv2.STEREO_SGBM_MODE_HH,
    cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    cv2.STEREO_SGBM_MODE_HH4,
)
DIRECTIONS = {0: 5, 1: 8, 2: 3}  # of the modes that are not left to OpenCV
WHOLE_MODES = (0, 1)
STRIPES = 4  # of mode 2
MEDIAN_PX = 3  # of the filter that follows
LEAST_CAP = 15  # of OpenCV, and an odd one
LARGEST_TOTAL = 2**15 - 1  # OpenCV sums in 16 bits
BORDER = int(Reason.BORDER)
NO_MATCH = int(Reason.NO_MATCH)


class SemiGlobalBlockMatcher(SerialMatcher):
    """``cv2.StereoSGBM`` (Hirschmueller 2008, with block costs of Birchfield and Tomasi 1998).

    Modes 0 to 2 (SGBM, HH, 3WAY) are computed by :mod:`stereo_depth_ros.matching.sgm.block_paths`, with the disparities
    of OpenCV bit for bit; mode 3 (HH4), and mode 2 of images so low that OpenCV mistakes their rows, by OpenCV. Modes 0
    and 1 process the whole image in one thread, as paths cross all rows; mode 2 has four stripes, as in OpenCV.

    Fractions of ``uniqueness_ratio``, ``P1`` and ``P2`` are cut off, see :func:`penalties`; ``disp12_max_diff`` 0 means
    1 px, as in OpenCV. As OpenCV, it does not tell why a pixel is rejected: NO_MATCH, or BORDER where the search leaves
    the right image. The speckle filter of this package gives the result of OpenCV and the reason SPECKLE.

    ``support_px`` is the window; the Sobel prefilter and the interpolation of the pixel costs read a little more.
    """

    name = "sgbm"
    step_px = 1 / X16_STEPS
    uses_one_core = True

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if OpenCV would crash or return wrong disparities with these parameters."""
        check_search(config)
        _check_window(config)
        P1, P2 = penalties(config)
        uniqueness = int(config.uniqueness_ratio)
        if config.sgbm_mode == 2 and uniqueness == 100:
            raise ConfigError(
                f"uniqueness_ratio = {config.uniqueness_ratio:g} divides by zero in sgbm_mode 2",
                value=config.uniqueness_ratio,
                limit=99,
                remedy="use 99 or less",
                settings=("uniqueness_ratio",),
            )
        super().__init__(config)
        self._invalid = (config.min_disparity - 1) * X16_STEPS
        self._speckle_filter = SpeckleFilter(config.speckle_size, config.speckle_range * X16_STEPS)
        self._disparity_x16: I16 = np.empty((0, 0), np.int16)
        self._search = _search(config, P1, P2)
        self._stripes: list[Stripe] = []
        self._scratch: list[BlockScratch] = []
        self._sgbm = cv2.StereoSGBM.create(
            minDisparity=config.min_disparity,
            numDisparities=config.num_disparities,
            blockSize=config.correlation_window_size,
            P1=P1,
            P2=P2,
            disp12MaxDiff=config.disp12_max_diff,
            preFilterCap=config.prefilter_cap,
            uniquenessRatio=uniqueness,
            speckleWindowSize=0,
            speckleRange=0,
            mode=MODES[config.sgbm_mode],
        )

    def _match(self, left: U8, right: U8) -> MatchResult:
        config = self.config
        check_pair(left, right, self)
        disparity_px = np.empty(left.shape, np.float32)
        reasons = np.empty(left.shape, np.uint8)
        if self._disparity_x16.shape != left.shape:
            self._allocate(*left.shape)
        if self._stripes:
            run_bands(self._match_stripes, len(self._stripes), left, right, min_rows=1)
            cv2.medianBlur(self._disparity_x16, MEDIAN_PX, self._disparity_x16)
        else:
            self._sgbm.compute(left, right, self._disparity_x16)
        begin = max(0, config.max_disparity + 1)
        end = left.shape[1] + min(0, config.min_disparity)
        run_bands(_reason_rows, left.shape[0], self._disparity_x16, self._invalid, begin, end, reasons)
        self._speckle_filter(self._disparity_x16, reasons)
        disparity_from_x16(self._disparity_x16, reasons, disparity_px)
        return MatchResult(disparity_px, reasons, self.step_px, functools.partial(local_consistency, disparity_px))

    def _allocate(self, height: int, width: int) -> None:
        self._disparity_x16 = np.empty((height, width), np.int16)
        self._stripes = _stripes(self.config, height)
        self._scratch = [BlockScratch.allocate(height, width, self._search) for _ in self._stripes]

    def _match_stripes(self, first: int, last: int, left: U8, right: U8) -> None:
        for stripe, scratch in zip(self._stripes[first:last], self._scratch[first:last], strict=True):
            match_blocks(*stripe, left, right, self._search, scratch, self._disparity_x16)


def penalties(config: MatchingConfig) -> tuple[int, int]:
    """P1 and P2 of the config, or if they are 0, 8 and 32 times the window area, as OpenCV recommends.

    They scale with the window because its cost is a sum. An automatic P2 leaves room for the costs in 16 bits.
    """
    area = config.correlation_window_size**2
    room = LARGEST_TOTAL - area * _largest_pixel_cost(config) // 2
    P1, P2 = int(config.P1), int(config.P2)
    P1 = P1 or min(8 * area, (P2 or room) // 2)
    return P1, P2 or max(min(32 * area, room), P1 + 1)


def _stripes(config: MatchingConfig, height: int) -> list[Stripe]:
    """The rows that are matched apart; none where OpenCV matches them."""
    if config.sgbm_mode in WHOLE_MODES:
        return [(0, 0, height)]
    rows = -(-height // STRIPES)
    above = config.correlation_window_size // 2 + 1 + math.ceil(0.1 * rows)  # where paths and windows begin
    if config.sgbm_mode not in DIRECTIONS or rows < above:  # OpenCV then mistakes the rows of a stripe
        return []
    edges = [min(n * rows, height) for n in range(STRIPES + 1)]
    return [(max(first - above, 0), first, last) for first, last in itertools.pairwise(edges)]


def _search(config: MatchingConfig, P1: int, P2: int) -> BlockSearch:
    P1 = P1 or 2  # as OpenCV does
    return BlockSearch(
        begin=max(config.max_disparity + 1, 0),
        min_disparity=config.min_disparity,
        num_disparities=config.num_disparities,
        cap=max(config.prefilter_cap, LEAST_CAP) | 1,
        radius=config.correlation_window_size // 2,
        P1=np.int16(P1),
        P2=np.int16(max(P2, P1 + 1)),
        uniqueness=int(config.uniqueness_ratio),
        tolerance=config.disp12_max_diff or 1,
        directions=DIRECTIONS.get(config.sgbm_mode, 0),
    )


def _largest_pixel_cost(config: MatchingConfig) -> int:
    return 2 * config.prefilter_cap + 63  # gradient, and gray / 4


def _check_window(config: MatchingConfig) -> None:
    """Raise ConfigError if the 16-bit costs of OpenCV overflow: it would return dense, wrong disparities."""
    # real windows stay below half of the worst case
    largest = math.isqrt(2 * LARGEST_TOTAL // _largest_pixel_cost(config))
    if config.correlation_window_size > largest:
        raise ConfigError(
            f"correlation_window_size = {config.correlation_window_size} overflows the 16-bit costs of sgbm with "
            f"prefilter_cap = {config.prefilter_cap}",
            value=config.correlation_window_size,
            limit=largest - 1 + largest % 2,
            remedy=f"use {largest - 1 + largest % 2} or less",
            settings=("correlation_window_size", "prefilter_cap"),
        )


@compiled("void(int64, int64, int16[:, ::1], int64, int64, int64, uint8[:, ::1])")
def _reason_rows(first: int, last: int, disparity_x16: I16, invalid: int, begin: int, end: int, reasons: U8) -> None:
    for y in range(first, last):
        for x in range(disparity_x16.shape[1]):
            outside = BORDER if x < begin or x >= end else NO_MATCH
            reasons[y, x] = 0 if disparity_x16[y, x] != invalid else outside

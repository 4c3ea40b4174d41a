# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global block matching with the results of OpenCV's StereoSGBM."""

from __future__ import annotations

import functools
import math

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

MODES = (
    cv2.STEREO_SGBM_MODE_SGBM,
    cv2.STEREO_SGBM_MODE_HH,
    cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    cv2.STEREO_SGBM_MODE_HH4,
)
OWN_MODES = (0, 1)
MEDIAN_PX = 3  # of the filter that follows
LEAST_CAP = 15  # of OpenCV, and an odd one
LARGEST_TOTAL = 2**15 - 1  # OpenCV sums in 16 bits
BORDER = int(Reason.BORDER)
NO_MATCH = int(Reason.NO_MATCH)


class SemiGlobalBlockMatcher(SerialMatcher):
    """``cv2.StereoSGBM`` (Hirschmueller 2008, with block costs of Birchfield and Tomasi 1998).

    Modes 0 and 1 (SGBM, HH) are kernels of this package with the same disparities, see
    :mod:`stereo_depth_ros.matching.sgm.block_paths`; modes 2 and 3 (3WAY, HH4) are computed by OpenCV. The whole image
    is processed in one thread, as paths cross all rows. Fractions of ``uniqueness_ratio``, ``P1`` and ``P2`` are cut
    off, see :func:`penalties`; ``disp12_max_diff`` 0 means 1 px, as in OpenCV. As OpenCV, it does not tell why a pixel
    is rejected: NO_MATCH, or BORDER where the search leaves the right image. The speckle filter of this package gives
    the result of OpenCV and the reason SPECKLE.

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
        self._own = config.sgbm_mode in OWN_MODES
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
            self._disparity_x16 = np.empty(left.shape, np.int16)
            if self._own:
                self._scratch = BlockScratch.allocate(len(left), left.shape[1], self._search)
        if self._own:
            match_blocks(left, right, self._search, self._scratch, self._disparity_x16)
            cv2.medianBlur(self._disparity_x16, MEDIAN_PX, self._disparity_x16)
        else:
            self._sgbm.compute(left, right, self._disparity_x16)
        begin = max(0, config.max_disparity + 1)
        end = left.shape[1] + min(0, config.min_disparity)
        run_bands(_reason_rows, left.shape[0], self._disparity_x16, self._invalid, begin, end, reasons)
        self._speckle_filter(self._disparity_x16, reasons)
        disparity_from_x16(self._disparity_x16, reasons, disparity_px)
        return MatchResult(disparity_px, reasons, self.step_px, functools.partial(local_consistency, disparity_px))


def penalties(config: MatchingConfig) -> tuple[int, int]:
    """P1 and P2 of the config, or if they are 0, 8 and 32 times the window area, as OpenCV recommends.

    They scale with the window because its cost is a sum. An automatic P2 leaves room for the costs in 16 bits.
    """
    area = config.correlation_window_size**2
    room = LARGEST_TOTAL - area * _largest_pixel_cost(config) // 2
    P1, P2 = int(config.P1), int(config.P2)
    P1 = P1 or min(8 * area, (P2 or room) // 2)
    return P1, P2 or max(min(32 * area, room), P1 + 1)


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
        both_ways=config.sgbm_mode == 1,
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

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptive windows: for every pixel the rectangle with the least uncertain disparity."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8, MatchResult
from stereo_depth_ros.matching.filters.speckle_filter import I16
from stereo_depth_ros.matching.protocol import X16_STEPS, check_pair
from stereo_depth_ros.matching.selection.float_costs import I64, finish, median_filter
from stereo_depth_ros.matching.serial import SerialMatcher
from stereo_depth_ros.matching.window.adaptive_window_kernel import Maps, distances, grow_window, scratch
from stereo_depth_ros.matching.window.fixed_window import WindowMatcher

__all__ = ["AdaptiveWindowMatcher"]

ITERATIONS = 4
LARGEST_STEP_PX = np.float32(1)  # the linear estimate of an increment is valid up to about a pixel
SURFACE_DISTANCE = 4  # px from a pixel to those whose disparity it may adopt
MEDIAN_SIDE = 5


class AdaptiveWindowMatcher(SerialMatcher):
    """Adaptive window (Kanade and Okutomi 1991, 1994), initialized by :class:`WindowMatcher`.

    For a pixel at distance r from the window center, with a possibly different disparity, the gray-level difference
    I - J has variance s^2(r) = 2 sigma^2 + af ad r: af is the power of the gradient J' in the window, ad
    the mean of (d - d_center)^2 / r. The increment of the disparity and its variance are
    sum (J - I) J' / s^2 / sum J'^2 / s^2 and 1 / sum J'^2 / s^2. The window starts as 3 x 3 and grows by one pixel in
    the direction of least variance, until every direction would raise it, leaves an image, meets a pixel without
    disparity, or is 10 px long. All pixels are incremented together, four times.

    Two extensions are needed, as the increments alone hardly improve the initial disparities, or degrade them where
    there is little texture:

    - Photometric differences: the means over the window (weighted by 1 / s^2) of I - J and of J' are subtracted first,
      which estimates a constant gray-level offset together with the increment.
    - Wrong surfaces: beside a step, a fixed window often selects the wrong surface, and the true disparity is beyond
      the range of an increment. So a window is also grown for the disparity of each pixel 4 px above, below, left and
      right that differs by more than 1 px, and the window of highest likelihood is selected: the one with the least
      mean of (I - J)^2 / s^2 + log s^2 after the increment.

    Distances are rounded to whole pixels, so that few sums describe a window; increments are limited to 1 px; a 5 x 5
    median follows each iteration, as outliers would keep the windows of their neighbors small. Pixels whose 3 x 3
    window leaves an image keep their disparity. A window has one disparity and may be asymmetric, so slanted surfaces
    become rough (mean error 0.11 px at a slant of 0.05, 0.04 px for a fixed window).

    ``window_cost``, ``max_difference``, ``correlation_window_size``, ``vertical_search``, the uniqueness and left-right
    checks are those of the window matcher and determine which pixels are rejected; refined windows have no row offset.
    ``support_px`` is the window of the initial match: refined windows stop at pixels without disparity.
    """

    name = "adaptive_window"
    step_px = 1 / X16_STEPS

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError if the search range does not fit in 16-bit disparities."""
        super().__init__(config)
        self._checked = WindowMatcher(dataclasses.replace(config, speckle_size=0))
        # Windows grow over all disparities: pixels rejected by the checks are only removed from the result.
        unchecked = dataclasses.replace(config, speckle_size=0, uniqueness_ratio=0.0, disp12_max_diff=0)
        self._initial = WindowMatcher(unchecked)

    def _match(self, left: U8, right: U8) -> MatchResult:
        check_pair(left, right, self)
        initial, checked = self._initial.match(left, right), self._checked.match(left, right)
        disparity_x16 = self._refine(left, right, initial)
        return finish(disparity_x16, checked.reasons, self.config, self.step_px)

    def _refine(self, left: U8, right: U8, initial: MatchResult) -> I16:
        """Disparities in 1/16 px after all iterations, 0 where the initial ones are invalid."""
        images = (left.astype(np.float32), right.astype(np.float32))
        slope = np.zeros_like(images[1])
        slope[:, 1:-1] = (images[1][:, 2:] - images[1][:, :-2]) / 2
        tables = (*distances(), *scratch(left.shape[0]))
        invalid = initial.reasons
        before, after = initial.disparity_px, np.empty_like(initial.disparity_px)
        for _ in range(ITERATIONS):
            run_bands(_refine_rows, left.shape[0], (*images, slope, before), *tables, after)
            np.clip(after, self.config.min_disparity, self.config.max_disparity, out=after)
            disparity_x16 = np.where(invalid, 0, np.rint(after * X16_STEPS)).astype(np.int16)
            disparity_x16 = median_filter(disparity_x16, invalid, MEDIAN_SIDE)
            before = np.where(invalid, np.float32(np.nan), disparity_x16 / np.float32(X16_STEPS))
        return disparity_x16


@compiled(
    numba.void(
        *(numba.int64, numba.int64, numba.types.UniTuple(numba.float32[:, ::1], 4), numba.float32[:, ::1]),
        *(numba.int64[:, ::1], numba.float32[:, :, :, ::1], numba.int64[:, :, ::1], numba.float32[:, ::1]),
    ),
    allocates=False,
)
def _refine_rows(
    first: int, last: int, maps: Maps, inverse: F32, rings: I64, all_sums: F32, all_extents: I64, after: F32
) -> None:
    """One iteration: disparities of a band of rows, each from its window of highest likelihood."""
    sums, extent, closed = all_sums[first], all_extents[first, 0], all_extents[first, 1]
    before = maps[3]
    height, width = before.shape
    for y in range(first, last):
        for x in range(width):
            after[y, x] = own = before[y, x]
            if np.isnan(own):
                continue
            least = np.float32(np.inf)
            for candidate in range(5):  # itself, then above, below, left, right
                row = y + SURFACE_DISTANCE * ((candidate == 2) - (candidate == 1))
                column = x + SURFACE_DISTANCE * ((candidate == 4) - (candidate == 3))
                if row < 0 or row >= height or column < 0 or column >= width:
                    continue
                center = before[row, column]
                if candidate > 0 and not abs(center - own) > LARGEST_STEP_PX:
                    continue
                increment, misfit = grow_window(maps, center, y, x, inverse, rings, sums, extent, closed)
                if misfit < least:
                    least = misfit
                    after[y, x] = center + min(max(increment, -LARGEST_STEP_PX), LARGEST_STEP_PX)

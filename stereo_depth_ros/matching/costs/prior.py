# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Costs of a prior: matching costs rise away from the disparities that another sensor expects, up to a bound."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numba import float32, int64

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8

__all__ = ["PRIOR_COSTS", "PriorCosts", "add_prior_costs", "prior_costs"]

# The most that a prior costs a disparity, in half bits of the census code. Right disparities cost about 25 less than
# unrelated pixels, so that a wrong point loses where the images have texture.
MOST_BITS = 20.0
FLAT_PX = 0.5  # from the expected disparity: the images decide within it
LEAST_WIDTH_PX = 1.0  # of the Gaussian, for points without error: whole disparities have costs
SLANT = 0.2  # growth of the width for each pixel of distance from the point
REACH_PX = 12  # of a point, in the image
REACH_SPACINGS = 2.0  # and in mean distances of the points, so that dense priors cost no more time
FADED_PX = 20.0  # distance at which the bound has fallen to 1 / e
SIMILAR_GRAY = 30.0  # the same of a difference of gray values: points of another surface count less
NEGLIGIBLE = 3.5  # widths from the expected disparity at which the cost is the bound up to a quarter of a percent


class PriorCosts(NamedTuple):
    """A prior as the kernel takes it, float32 (H, W) each; (0, 0) without a prior.

    ``disparity_px`` is NaN where nothing is expected, ``width_px`` the standard deviation of the Gaussian and ``most``
    the bound of the cost, in half bits.
    """

    disparity_px: F32
    width_px: F32
    most: F32


PRIOR_COSTS = numba.types.NamedUniTuple(float32[:, ::1], 3, PriorCosts)


def prior_costs(prior: DisparityPrior | None, image: U8) -> PriorCosts:
    """A prior, spread over the neighborhood of its points; empty arrays for None.

    A pixel expects the disparity of the point for which r / 20 px + |g| / 30 is least, r being the distance, at most 12
    px, and g the difference of the gray values. The bound of its cost is 20 times exp(-r / 20 px - |g| / 30), the
    variance of the Gaussian sigma^2 + 1 px^2 + (0.2 r)^2.

    Args:
        prior: points of the left image.
        image: uint8 (H, W), the left image.
    """
    if prior is None:
        return PriorCosts(*(np.empty((0, 0), np.float32) for _ in PriorCosts._fields))
    spread = PriorCosts(*(np.empty(image.shape, np.float32) for _ in PriorCosts._fields))
    share = np.count_nonzero(prior.known) / image.size
    reach = min(REACH_PX, math.ceil(REACH_SPACINGS / math.sqrt(share))) if share else 0
    run_bands(_spread, len(image), image, prior.disparity_px, prior.sigma_px, reach, spread)
    return spread


_FADED, _SIMILAR, _MOST = np.float32(FADED_PX), np.float32(SIMILAR_GRAY), np.float32(MOST_BITS)
_LEAST_VARIANCE, _SLANT_SQUARED = np.float32(LEAST_WIDTH_PX**2), np.float32(SLANT**2)
_FLAT, _NEGLIGIBLE, _LIMIT = np.float32(FLAT_PX), np.float32(NEGLIGIBLE), np.uint8(62)
_HALF, _ZERO, _ONE = np.float32(0.5), np.float32(0), np.float32(1)


@compiled(numba.void(int64, int64, READ_ONLY_U8, float32[:, ::1], float32[:, ::1], int64, PRIOR_COSTS))
def _spread(first: int, last: int, image: U8, disparity_px: F32, sigma_px: F32, reach: int, spread: PriorCosts) -> None:
    """Rows first to last of the spread prior; ``most`` holds the least sum of the exponent meanwhile."""
    height, width = image.shape
    side = 2 * reach + 1
    away = np.empty((side, side), np.float32)
    for j in range(side):
        for i in range(side):
            away[j, i] = np.sqrt(np.float32((i - reach) ** 2 + (j - reach) ** 2))
    spread.disparity_px[first:last] = np.nan
    spread.width_px[first:last] = _ONE
    spread.most[first:last] = np.inf
    for y in range(max(first - reach, 0), min(last + reach, height)):
        for x in range(width):
            expected = disparity_px[y, x]
            if not np.isfinite(expected):
                continue
            gray = np.float32(image[y, x])
            variance = sigma_px[y, x] * sigma_px[y, x] + _LEAST_VARIANCE
            for v in range(max(y - reach, first), min(y + reach + 1, last)):
                for u in range(max(x - reach, 0), min(x + reach + 1, width)):
                    distance = away[v - y + reach, u - x + reach]
                    exponent = distance / _FADED + abs(np.float32(image[v, u]) - gray) / _SIMILAR
                    if exponent < spread.most[v, u]:
                        spread.most[v, u] = exponent
                        spread.disparity_px[v, u] = expected
                        spread.width_px[v, u] = np.sqrt(variance + _SLANT_SQUARED * distance * distance)
    for y in range(first, last):
        for x in range(width):
            spread.most[y, x] = _MOST * np.exp(-spread.most[y, x])


@compiled(allocates=False)
def _raise(cost: U8, by: np.uint8) -> None:
    for k in range(cost.size):
        cost[k] = min(np.uint8(cost[k] + by), _LIMIT)


@compiled(allocates=False)
def add_prior_costs(prior: PriorCosts, y: int, max_disparity: int, count: int, cost: U8) -> None:
    """Add the costs of the prior to the ``count`` first matching costs of the pixels of row ``y``, uint8 (W, K).

    C'(d) = min(C(d) + most (1 - exp(-max(|d - expected| - 0.5, 0)^2 / (2 width^2))), 62), whole numbers; after Poggi
    et al. (Guided stereo matching, CVPR 2019), who multiply costs by a Gaussian. A sum has a bound.

    Index k of a cost counts down from ``max_disparity``. An empty prior and disparities that are not searched have no
    effect.
    """
    if prior.disparity_px.size == 0:
        return
    for x in range(cost.shape[0]):
        expected = prior.disparity_px[y, x]
        if np.isnan(expected):
            continue
        here, center = cost[x, :count], np.float32(max_disparity) - expected
        if center < -_HALF or center > np.float32(here.size) - _HALF:
            continue
        most, width = prior.most[y, x], prior.width_px[y, x]
        reach = _FLAT + _NEGLIGIBLE * width
        begin = min(max(int(np.ceil(center - reach)), 0), here.size)
        end = max(min(int(np.floor(center + reach)) + 1, here.size), begin)
        _raise(here[:begin], np.uint8(np.rint(most)))
        for k in range(begin, end):
            away = max(abs(np.float32(k) - center) - _FLAT, _ZERO) / width
            _raise(here[k : k + 1], np.uint8(np.rint(most * (_ONE - np.exp(-_HALF * away * away)))))
        _raise(here[end:], np.uint8(np.rint(most)))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Brightness: the left image as bright as the right one, region by region."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.window.fixed_window import WindowMatcher

__all__ = ["match_photometric"]

FIRST_WINDOW_PX = 9
REGION_PX = 31
LARGEST_VARIATION = np.float32(15)  # gray levels from the median of all; beyond it a match is wrong, or an outlier
LEAST_SHARE = 0.05  # of a region that is matched, from which on its mean difference counts for half or more


def match_photometric(left: U8, right: U8, config: MatchingConfig) -> U8:
    """The left image less what it is brighter than the right one, on average over the matched pixels of a region.

    Costs of single pixels take a point to be equally bright in both images. Really it differs by a few levels, which
    is more than many pixels differ that should be told apart: the light that reaches two cameras from one surface is
    not the same. But neighbors differ alike (Gennert 1988). A first match of zero-mean windows, which need no equal
    brightness, tells by how much; where nothing matches (no texture, windows of one pixel), nothing changes.

    Args:
        left, right: uint8 (H, W), gray, rectified, which the window matcher accepts with ``config``.
        config: the search, and ``correlation_window_size`` for the first match, up to 9 px.

    Returns:
        uint8 (H, W).
    """
    first = WindowMatcher(
        MatchingConfig(
            window_cost="zssd",
            min_disparity=config.min_disparity,
            num_disparities=config.num_disparities,
            correlation_window_size=min(config.correlation_window_size, FIRST_WINDOW_PX),
            uniqueness_ratio=10.0,
            disp12_max_diff=1,
            speckle_range=1,
        )
    ).match(left, right)
    matched = first.reasons == 0
    rows, columns = np.indices(left.shape, np.float32)
    partners = columns - np.where(matched, first.disparity_px, np.float32(0))
    difference = left - cv2.remap(right.astype(np.float32), partners, rows, cv2.INTER_LINEAR)
    usual = np.median(difference[matched]) if matched.any() else np.float32(0)
    bounded = np.clip(difference, usual - LARGEST_VARIATION, usual + LARGEST_VARIATION)
    region = (REGION_PX, REGION_PX)
    total = cv2.blur(np.where(matched, bounded, np.float32(0)), region)
    share = cv2.blur(matched.astype(np.float32), region)
    corrected: U8 = np.clip(np.rint(left - total / (share + np.float32(LEAST_SHARE))), 0, 255).astype(np.uint8)
    return corrected

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Photometric correction: local gray-level offsets between the left and the right image."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.window.fixed_window import WindowMatcher

__all__ = ["match_photometric"]

INITIAL_WINDOW_PX = 9
REGION_PX = 31
LARGEST_VARIATION = np.float32(15)  # gray levels from the median; larger ones are wrong matches or outliers
LEAST_SHARE = 0.05  # matched share of a region at which its mean difference has half weight


def match_photometric(left: U8, right: U8, config: MatchingConfig) -> U8:
    """The left image minus its gray-level offset from the right one, averaged over the matched pixels of a region.

    Pixel-wise costs assume equal gray levels in both images. In practice a point differs by a few gray levels between
    the cameras, more than many pixels that must be distinguished, but neighbors differ alike (Gennert 1988). The offset
    is estimated from an initial match with zero-mean windows, which do not assume equal gray levels; where nothing
    matches (no texture, windows of one pixel), the image is unchanged.

    Args:
        left, right: uint8 (H, W), gray, rectified, valid for the window matcher with ``config``.
        config: the search range, and ``correlation_window_size`` of the initial match, up to 9 px.

    Returns:
        uint8 (H, W).
    """
    initial = WindowMatcher(
        MatchingConfig(
            window_cost="zssd",
            min_disparity=config.min_disparity,
            num_disparities=config.num_disparities,
            correlation_window_size=min(config.correlation_window_size, INITIAL_WINDOW_PX),
            uniqueness_ratio=10.0,
            disp12_max_diff=1,
            speckle_range=1,
        )
    ).match(left, right)
    matched = initial.reasons == 0
    rows, columns = np.indices(left.shape, np.float32)
    partners = columns - np.where(matched, initial.disparity_px, np.float32(0))
    difference = left - cv2.remap(right.astype(np.float32), partners, rows, cv2.INTER_LINEAR)
    usual = np.median(difference[matched]) if matched.any() else np.float32(0)
    bounded = np.clip(difference, usual - LARGEST_VARIATION, usual + LARGEST_VARIATION)
    region = (REGION_PX, REGION_PX)
    total = cv2.blur(np.where(matched, bounded, np.float32(0)), region)
    share = cv2.blur(matched.astype(np.float32), region)
    corrected: U8 = np.clip(np.rint(left - total / (share + np.float32(LEAST_SHARE))), 0, 255).astype(np.uint8)
    return corrected

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Known photometric differences are removed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.photometric import match_photometric

CONFIG = MatchingConfig(num_disparities=32)


def textured_pair(shift: int) -> tuple[U8, U8]:
    rng = np.random.default_rng(5)
    wall = cv2.GaussianBlur(rng.uniform(0, 255, (90, 260)).astype(np.float32), (0, 0), 1.2)
    wall = cv2.normalize(wall, None, 60, 180, cv2.NORM_MINMAX)
    left, right = wall[:, 40:240], wall[:, 40 + shift : 240 + shift]
    return np.rint(left).astype(np.uint8), np.rint(right).astype(np.uint8)


def ramp(low: float, high: float) -> np.ndarray:
    return np.linspace(low, high, 200)[np.newaxis] + np.linspace(-3, 3, 90)[:, np.newaxis]


@pytest.mark.parametrize(("low", "high"), [(-4.0, 12.0), (-55.0, -40.0)])
@pytest.mark.parametrize(("shift", "min_disparity"), [(9, 0), (-14, -20)])
def test_a_smooth_difference_is_removed(low: float, high: float, shift: int, min_disparity: int) -> None:
    left, right = textured_pair(shift)
    brighter = np.rint(left + ramp(low, high)).astype(np.uint8)
    config = MatchingConfig(num_disparities=32, min_disparity=min_disparity)
    error = match_photometric(brighter, right, config).astype(int) - left
    inner = error[20:-20, 40:-40]
    # A share of 0.05 / 1.05 stays, up to 2.7 of 57 levels; both images and the result are rounded.
    assert np.abs(inner).max() <= 1 + 0.05 * max(abs(low), abs(high))
    assert np.abs(inner).mean() < 0.4 + 0.05 * max(abs(low), abs(high))


def test_equal_and_unmatched_images_are_unchanged() -> None:
    left, right = textured_pair(9)
    inner = np.s_[16:-16, 40:]
    np.testing.assert_allclose(match_photometric(left, right, CONFIG)[inner].astype(int), left[inner], atol=1)
    flat = np.full((40, 90), 100, np.uint8)
    np.testing.assert_array_equal(match_photometric(flat, flat - np.uint8(20), CONFIG), flat)
    one_pixel = MatchingConfig(num_disparities=32, correlation_window_size=1)
    np.testing.assert_array_equal(match_photometric(left, right, one_pixel), left)


def test_outliers_do_not_darken_their_neighbors() -> None:
    left, right = textured_pair(9)
    shining = left.copy()
    shining[40:50, 100:110] = 255  # a reflection in one image
    error = match_photometric(shining, right, CONFIG).astype(int) - shining
    # Were all of it matched and none bounded, the 100 px of 961 would take about 13 levels away.
    assert np.abs(error[16:-16, 40:-20]).max() <= 3

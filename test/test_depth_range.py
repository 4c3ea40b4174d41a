# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Depth range of a rig: against Z = f B / (d - doffs), and against triangulation of noisy disparities."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.geometry.depth_range import (
    Precision,
    default_nearest_m,
    depth_errors,
    depth_range,
    recommended_search,
    rounded_depths_m,
)

RIG = StereoRig.from_rectified(400.0, 420.0, 330.0, 318.0, 205.0, 0.125, (640, 430))  # f B = 50, doffs = 12
PRECISION = Precision(step_px=1 / 16, sigma_px=0.25, max_error=0.05)


def test_range() -> None:
    found = depth_range(RIG, MatchingConfig(min_disparity=16, num_disparities=64), PRECISION)
    assert found.baseline_m == pytest.approx(0.125)
    assert found.nearest_m == pytest.approx(50 / (79 - 12))
    assert found.farthest_m == pytest.approx(0.05 * 50 / 0.25)
    assert found.search_end_m == pytest.approx(50 / 4)
    wide = depth_range(RIG, MatchingConfig(min_disparity=0, num_disparities=64), PRECISION, 2.0)
    assert wide.farthest_m == pytest.approx(2 * found.farthest_m)
    assert wide.search_end_m == math.inf


def test_the_error_at_the_farthest_depth_is_the_acceptable_one() -> None:
    farthest_m = depth_range(RIG, MatchingConfig(), PRECISION).farthest_m
    (error,) = depth_errors(RIG, [farthest_m], PRECISION)
    assert error.sigma_m == pytest.approx(0.05 * farthest_m, rel=1e-5)


def test_sigma_is_that_of_noisy_disparities() -> None:
    (error,) = depth_errors(RIG, [4.0], PRECISION)
    random = np.random.default_rng(1)
    left = np.tile([300.0, 200.0], (40000, 1))
    right = left - np.column_stack((error.disparity_px + 0.25 * random.standard_normal(40000), np.zeros(40000)))
    depths = Triangulation.from_rig(RIG).points(left, right)[:, 2]
    assert error.sigma_m == pytest.approx(depths.std(), rel=0.02)


def test_errors_at_a_depth() -> None:
    (error,) = depth_errors(RIG, [5.0], PRECISION)
    assert error.disparity_px == pytest.approx(50 / 5 + 12)
    assert error.step_m == pytest.approx(50 / (10 - 1 / 16) - 5)
    assert error.sigma_m == pytest.approx(25 / 50 * 0.25, rel=1e-6)
    assert error.overlap == pytest.approx(1 - 22 / 640)
    assert error.common_width_m == pytest.approx((640 - 22) * 5 / 400)


def test_the_step_to_infinity_is_infinite() -> None:
    (error,) = depth_errors(RIG, [50 * 16.0], PRECISION)
    assert error.step_m == math.inf


def test_recommended_search_reaches_from_the_distance_to_infinity() -> None:
    for nearest_m in (0.2, 0.55, 1.3, 40):
        search = recommended_search(RIG, nearest_m)
        assert search.min_disparity == 12
        assert search.max_disparity >= 50 / nearest_m + 12
        assert search.num_disparities == 32 or search.max_disparity - 16 < 50 / nearest_m + 13
    # Disparities that are whole up to rounding count as whole
    rounded = StereoRig.from_rectified(400.0, 420.0, 330.0, 330.0 - 1e-9, 205.0, 0.125, (640, 430))
    assert recommended_search(rounded, 1.0).min_disparity == 0


def test_default_nearest_is_an_eighth_of_the_width() -> None:
    assert 50 / default_nearest_m(RIG) == pytest.approx(640 / 8)


@pytest.mark.parametrize(
    ("first_m", "last_m", "step_m"), [(0.3, 12, 1), (0.3, 4, 0.5), (0.3, 0.8, 0.1), (2, 900, 5), (0.5, 3000, 20)]
)
def test_rounded_depths(first_m: float, last_m: float, step_m: float) -> None:
    depths = rounded_depths_m(first_m, last_m)
    np.testing.assert_allclose(np.diff(depths), step_m)
    assert first_m <= depths[0] < first_m + step_m
    assert last_m - step_m < depths[-1] <= last_m
    assert len(depths) <= 201


def test_invalid_values() -> None:
    with pytest.raises(ConfigError, match="sigma_px = 0 is not above 0"):
        Precision(1 / 16, 0, 0.05)
    with pytest.raises(ConfigError, match="depth error 150 % is above 100 %"):
        Precision(1 / 16, 0.25, 1.5)
    with pytest.raises(ConfigError, match=r"search ends at 11 px, below the disparity of infinity, 12\.00 px"):
        depth_range(RIG, MatchingConfig(min_disparity=-20, num_disparities=32), PRECISION)
    with pytest.raises(ConfigError, match=r"at 0\.05 m the disparity is 1012 px and the images are 640 px wide"):
        recommended_search(RIG, 0.05)
    with pytest.raises(ConfigError, match="nearest distance -1 m is not above 0"):
        recommended_search(RIG, -1)

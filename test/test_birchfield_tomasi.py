# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pixel costs against their definition, written down with an interpolation on a fine grid."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.matching.costs.birchfield_tomasi import OUTSIDE, birchfield_tomasi


def distance_to_signal(value: float, row: np.ndarray, at: int) -> float:
    """Least distance of a value to a linearly interpolated row within half a pixel of a position."""
    positions = np.arange(len(row))
    half = np.linspace(at - 0.5, at + 0.5, 101)
    # Linear pieces have their extremes at their ends, all of which are on this grid; between them values are reached.
    signal = np.interp(half, positions, row)
    return max(0.0, signal.min() - value, value - signal.max())


@pytest.mark.parametrize("min_disparity", [-5, 0, 3])
def test_cost_is_the_smaller_distance_to_the_interpolated_other_row(min_disparity: int) -> None:
    rng = np.random.default_rng(7)
    left, right = rng.integers(0, 256, (2, 4, 13)).astype(np.uint8)
    costs = birchfield_tomasi(left, right, min_disparity, 7)
    assert costs.shape == (4, 13, 7) and costs.dtype == np.uint16
    for y, x, k in np.ndindex(costs.shape):
        at = x - min_disparity - k
        if not 0 <= at < 13:
            assert costs[y, x, k] == OUTSIDE
            continue
        expected = min(
            distance_to_signal(float(left[y, x]), right[y].astype(float), at),
            distance_to_signal(float(right[y, at]), left[y].astype(float), x),
        )
        assert costs[y, x, k] / 2 == pytest.approx(expected, abs=1e-9)


def test_half_a_pixel_of_shift_has_no_cost_on_a_ramp() -> None:
    x = np.arange(20)
    left = np.tile(10 * x + 5, (3, 1)).astype(np.uint8)
    right = np.tile(10 * x + 40, (3, 1)).astype(np.uint8)  # the left ramp, seen 3.5 px further to the left
    costs = birchfield_tomasi(left, right, 0, 8)
    inner = costs[:, 8:-1]
    # 5 gray levels away from the pixels at 3 and 4, but within the intervals of both; 10 levels a px beyond.
    np.testing.assert_array_equal(np.unique(inner.reshape(-1, 8), axis=0), [[60, 40, 20, 0, 0, 20, 40, 60]])


def test_read_only_and_strided_images_are_accepted() -> None:
    rng = np.random.default_rng(1)
    left, right = rng.integers(0, 256, (2, 5, 12)).astype(np.uint8)
    expected = birchfield_tomasi(left[:, ::-1].copy(), right[:, ::-1].copy(), 0, 4)
    left.setflags(write=False)
    np.testing.assert_array_equal(birchfield_tomasi(left[:, ::-1], right[:, ::-1], 0, 4), expected)

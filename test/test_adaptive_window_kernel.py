# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Single windows: where they stop, and against the definition."""

from __future__ import annotations

import numpy as np
import pytest
from adaptive_window_definition import grown_window, warped_pair

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.matching.window import adaptive_window_kernel


def compiled_window(maps: list[F64], y: int, x: int, center: float) -> tuple[float, float, list[int]]:
    """Increment, how unlikely the pixels are, and extents, of the kernel."""
    left, right, before = (image.astype(np.float32) for image in maps)
    slope = np.zeros_like(right)
    slope[:, 1:-1] = (right[:, 2:] - right[:, :-2]) / 2
    sums, extents = adaptive_window_kernel.scratch(1)
    tables = (*adaptive_window_kernel.distances(), sums[0], extents[0, 0], extents[0, 1])
    increment, surprise = adaptive_window_kernel.grow_window(
        (left, right, slope, before), np.float32(center), y, x, *tables
    )
    return increment, surprise, list(extents[0, 0])


def test_windows_stop_at_a_step_of_disparity() -> None:
    disparity = np.full((40, 90), 6, np.float32)
    disparity[:, 45:] = 14
    maps = [image.astype(np.float64) for image in (*warped_pair(40, 90, disparity), disparity)]
    _, _, (up, down, to_left, to_right) = compiled_window(maps, 20, 48, 14.0)
    assert (up, down, to_right) == (10, 10, 10)
    assert to_left == 3


@pytest.mark.parametrize(("y", "x", "center"), [(20, 48, 14.0), (20, 48, 6.0), (11, 70, 13.75), (2, 30, 6.0)])
def test_a_window_is_the_definition(y: int, x: int, center: float) -> None:
    disparity = np.full((40, 90), 6, np.float32)
    disparity[:, 45:] = 14
    maps = [image.astype(np.float64) for image in (*warped_pair(40, 90, disparity), disparity)]
    expected, extent = grown_window(maps, y, x, center)
    assert expected is not None
    increment, surprise, grown = compiled_window(maps, y, x, center)
    assert grown == extent
    # Sums are float32, from which the gray offset is subtracted.
    assert increment == pytest.approx(expected.increment, abs=5e-3)
    assert surprise == pytest.approx(expected.surprise, abs=5e-3)


@pytest.mark.parametrize(("y", "x"), [(0, 40), (39, 40), (20, 7), (20, 61)])
def test_no_window_leaves_an_image_or_holds_a_pixel_without_disparity(y: int, x: int) -> None:
    disparity = np.full((40, 90), 6, np.float32)
    disparity[20, 60] = np.nan
    maps = [image.astype(np.float64) for image in (*warped_pair(40, 90, np.nan_to_num(disparity, nan=6)), disparity)]
    increment, surprise, _ = compiled_window(maps, y, x, 6.0)
    assert increment == 0 and surprise == np.inf

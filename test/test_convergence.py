# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The subject is the nearest large surface, and it is in the same columns of both images after the shift."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.views.convergence import Convergence, common_columns, converged, subject_disparity


def room(subject_px: float, subject_columns: int = 40) -> np.ndarray:
    """A wall at 6 px, a subject in the middle, a small nearer thing, and a border without disparities."""
    disparity_px = np.full((80, 120), 6.2, np.float32)
    disparity_px[20:70, 40 : 40 + subject_columns] = subject_px
    disparity_px[60:64, 50:56] = subject_px + 20
    disparity_px[:, :15] = np.nan
    return disparity_px


def test_subject_is_the_nearest_large_surface() -> None:
    assert subject_disparity(room(21.3)) == 21
    assert subject_disparity(room(-11.6) - 20) == -14  # the wall is nearer: 6.2 - 20
    assert subject_disparity(room(21.3, subject_columns=6)) == 6
    assert subject_disparity(np.full((8, 8), np.nan, np.float32)) == 0


def test_slanted_subject_has_its_middle_at_the_screen() -> None:
    disparity_px = np.full((80, 120), 2.0, np.float32)
    disparity_px[:, 20:100] = np.linspace(30, 33.9, 80, dtype=np.float32)
    assert 31 <= subject_disparity(disparity_px) <= 33


@pytest.mark.parametrize("shift_px", [0, 1, 7, 8, -5])
def test_surface_at_the_screen_is_in_equal_columns(shift_px: int) -> None:
    left = np.random.default_rng(2).integers(1, 255, (4, 50, 3), np.uint8)
    right = np.roll(left, -shift_px, axis=1)
    first, last = common_columns(50, shift_px)
    assert last - first == 50 - abs(shift_px)
    moved = converged(left, right, shift_px)
    np.testing.assert_array_equal(moved[0], moved[1])
    assert moved[0][:, first:last].all()
    assert not moved[0][:, :first].any() and not moved[0][:, last:].any()


def test_shift_beyond_the_width_leaves_nothing() -> None:
    image = np.full((2, 9), 200, np.uint8)
    assert not converged(image, image, 40)[0].any()


def test_screen_follows_the_subject_in_steps() -> None:
    convergence = Convergence()
    assert convergence.follow(room(21)) == 21
    assert [convergence.follow(room(24)) for _ in range(4)] == [22, 23, 24, 24]
    assert convergence.follow(room(12)) == 23
    convergence.restart()
    assert convergence.follow(room(12)) == 12

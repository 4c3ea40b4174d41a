# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Row errors of matched features: against images shifted by known amounts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stereo_depth_ros.calibration.row_error import RowMatches, match_rows
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F64, U8

WIDTH, HEIGHT = 440, 280
_RANDOM = np.random.default_rng(3)
WAVES = _RANDOM.normal(0, 0.35, (2, 60))  # radians per pixel
PHASES = _RANDOM.uniform(0, 2 * np.pi, 60)


def image(x: F64, y: F64) -> U8:
    """A texture of waves in all directions, exact at any position."""
    gray = np.cos(x[..., None] * WAVES[0] + y[..., None] * WAVES[1] + PHASES).sum(axis=2)
    return np.asarray(np.clip(128 + 15 * gray, 0, 255), np.uint8)


def texture() -> U8:
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    return image(x, y)


def seen_by_right(disparity_px: float, down_px: F64 | float) -> U8:
    """The texture with every pixel moved to the left by the disparity, and down."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    return image(x + disparity_px, y - down_px)


@pytest.mark.parametrize("down_px", [0.0, 0.3, -2.7, 11.4])
def test_shift_of_all_rows(down_px: float) -> None:
    left = texture()
    matches = match_rows(left, seen_by_right(17.3, down_px))
    assert len(matches) > 200
    assert np.median(matches.errors_px) == pytest.approx(-down_px, abs=0.02)
    assert matches.median_px == pytest.approx(abs(down_px), abs=0.05)
    disparity = matches.left_px[:, 0] - matches.right_px[:, 0]
    assert np.median(disparity) == pytest.approx(17.3, abs=0.02)


def test_row_errors_that_vary_across_the_image() -> None:
    """As from a camera that has rolled: errors from -3 to 3 px, each measured to a tenth."""
    left = texture()
    across = np.linspace(-3, 3, WIDTH)
    matches = match_rows(left, seen_by_right(9.0, np.broadcast_to(across, (HEIGHT, WIDTH))))
    expected = -np.interp(matches.right_px[:, 0], np.arange(WIDTH), across)
    assert np.ptp(expected) > 5
    assert np.sqrt(np.mean((matches.errors_px - expected) ** 2)) < 0.1


def test_matches_cover_the_image() -> None:
    """Although one half has half the contrast."""
    left, right = texture(), seen_by_right(5.0, 0.4)
    for each in (left, right):
        each[:, WIDTH // 2 :] = 64 + each[:, WIDTH // 2 :] // 2
    parts = (match_rows(left, right).left_px // (WIDTH / 4, HEIGHT / 3)).astype(np.intp)
    assert np.bincount(parts @ [1, 4], minlength=12).min() >= 15


def test_outliers_are_removed() -> None:
    """A part of the right image is 9 px higher than the rest, as a reflection or a moving object."""
    left = texture()
    right = seen_by_right(6.0, 0.5)
    right[90:170, 100:220] = seen_by_right(6.0, -9.0)[90:170, 100:220]
    matches = match_rows(left, right)
    assert np.abs(matches.errors_px + 0.5).max() < 1.2


def test_nothing_is_found_beyond_the_rows_searched() -> None:
    left = texture()
    assert len(match_rows(left, seen_by_right(3.0, 40.0))) < 20


def test_deterministic() -> None:
    left = texture()
    right = seen_by_right(8.0, 1.0)
    first, second = match_rows(left, right), match_rows(left, right)
    np.testing.assert_array_equal(first.left_px, second.left_px)
    np.testing.assert_array_equal(first.right_px, second.right_px)


def test_images_without_features() -> None:
    flat = np.full((HEIGHT, WIDTH), 77, np.uint8)
    for pair in ((flat, flat), (texture(), flat), (flat, texture())):
        matches = match_rows(*pair)
        assert len(matches) == 0
        assert math.isnan(matches.median_px)
        assert math.isnan(matches.rms_px)


def test_figures() -> None:
    matches = RowMatches(np.array([[5.0, 1], [6, 2], [7, 9]]), np.array([[3.0, 2], [5, 2.5], [2, 6]]))
    np.testing.assert_array_equal(matches.errors_px, [-1, -0.5, 3])
    assert matches.median_px == 1
    assert matches.rms_px == pytest.approx(math.sqrt(10.25 / 3))


def test_images_that_are_not_a_pair() -> None:
    left = texture()
    with pytest.raises(ImageError, match=r"right image is float64 of shape \(280, 440\)"):
        match_rows(left, left.astype(np.float64))
    with pytest.raises(ImageError, match="both must have one size"):
        match_rows(left, left[:-1])

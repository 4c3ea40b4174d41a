# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pixels near depth edges and of thin structures, counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core.types import F32
from stereo_depth_ros.evaluation.hard_regions import hard_regions

HEIGHT, WIDTH = 60, 90


def wall(disparity_px: float = 10.0) -> F32:
    return np.full((HEIGHT, WIDTH), disparity_px, np.float32)


def columns(first: int, last: int) -> np.ndarray:
    inside = np.zeros((HEIGHT, WIDTH), np.bool_)
    inside[:, first : last + 1] = True
    return inside


def test_edges_are_within_4_px_of_the_pixels_of_a_step() -> None:
    truth = wall()
    truth[:, 40:] = 12.25  # the step is between columns 39 and 40
    np.testing.assert_array_equal(hard_regions(truth).edges, columns(35, 44))
    np.testing.assert_array_equal(hard_regions(truth.T.copy()).edges, columns(35, 44).T)
    truth[:, 40:] = 12.0  # 2 px are no edge
    assert not hard_regions(truth).edges.any()


def test_a_corner_of_a_depth_edge() -> None:
    truth = wall()
    truth[30:, 50:] = 20
    edges = hard_regions(truth).edges
    near = np.zeros_like(edges)
    near[25:, 45:] = True
    near[35:, 55:] = near[25, 45] = False  # the pixel across the corner has no neighbor on the other side
    np.testing.assert_array_equal(edges, near)


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize(("width", "thin"), [(1, True), (7, True), (8, False), (12, False)])
def test_poles_thinner_than_8_px(width: int, thin: bool, flipped: bool) -> None:
    truth, pole = wall(), columns(41, 40 + width)
    truth[pole] = 13
    if flipped:
        truth, pole = truth.T.copy(), pole.T
    np.testing.assert_array_equal(hard_regions(truth).thin, pole & thin)


def test_a_slanted_pole_is_measured_across() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    across = ((u - 20) * 0.8 - v * 0.6) + 0.1  # of a line of slope 3 to 4
    inner = (u > 8) & (u < WIDTH - 9) & (v > 8) & (v < HEIGHT - 9)
    for width, share in ((6.0, 1.0), (10.0, 0.0)):
        pole = np.abs(across) < width / 2
        thin = hard_regions(np.where(pole, 30, wall()).astype(np.float32)).thin
        assert np.mean(thin[pole & inner]) == pytest.approx(share, abs=0.02)
        assert not thin[~pole].any()


def test_neither_slants_nor_gaps_in_front_of_a_wall_are_thin() -> None:
    slant = wall() + 0.9 * np.arange(WIDTH, dtype=np.float32)
    found = hard_regions(slant)
    assert not found.edges.any() and not found.thin.any()
    truth = wall(20)
    truth[columns(41, 44)] = 10  # a slit, behind its surroundings
    assert not hard_regions(truth).thin.any()


def test_a_rectangle_has_three_thin_pixels_at_each_corner() -> None:
    truth = wall()
    truth[20:45, 30:70] = 16
    thin = hard_regions(truth).thin
    corner = np.zeros_like(thin)
    for y, x in ((20, 30), (20, 31), (21, 30)):
        corner[y, x] = corner[64 - y, x] = corner[y, 99 - x] = corner[64 - y, 99 - x] = True
    np.testing.assert_array_equal(thin, corner)


def test_unknown_truth_is_background_and_in_no_region() -> None:
    truth, pole = wall(), columns(41, 44)
    truth[pole] = 13
    truth[columns(35, 40)] = np.nan  # occluded at the left of the pole
    truth[10, 42] = np.inf
    found = hard_regions(truth)
    known = np.isfinite(truth)
    np.testing.assert_array_equal(found.thin, pole & known)
    np.testing.assert_array_equal(found.edges, (columns(36, 40) | columns(41, 49)) & known)


def test_border_of_the_image_makes_nothing_thin() -> None:
    truth = wall()
    truth[:, :3] = 20
    truth[:2] = 25
    assert not hard_regions(truth).thin[:, 3:].any()
    assert not hard_regions(np.where(columns(0, 2), 20, wall()).astype(np.float32)).thin.any()

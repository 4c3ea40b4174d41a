# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Refinement along the row and checks of matched corners, on drawn scenes whose disparities are known."""

from __future__ import annotations

import numpy as np
import pytest
from test_features import blobs

from stereo_depth_ros.core.types import F64, U8, Reason
from stereo_depth_ros.matching.features.corner_checks import agree_with_neighbors, check_corners
from stereo_depth_ros.matching.features.row_search import Pixels, search_rows

HEIGHT, WIDTH = 90, 170
SEARCH_PX = (-4, 31)


def spots(disparity_px: float, seed: int = 1) -> tuple[U8, U8]:
    """Random spots; the right image has another gain and offset."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-40, WIDTH + 40, 500), rng.uniform(0, HEIGHT, 500)
    size, gray = rng.uniform(1.5, 4, 500), rng.uniform(20, 60, 500) * rng.choice([-1, 1], 500)
    left, right = (blobs(x - d, y, size, gray, HEIGHT, WIDTH) for d in (0, disparity_px))
    return left, np.rint(0.8 * right + 20).astype(np.uint8)


def grid() -> F64:
    return np.stack(np.meshgrid(np.arange(45.3, 150, 13), np.arange(12.8, 80, 11)), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("disparity_px", [7.37, -2.6, 20.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_sub_pixel_disparities_whatever_gain_and_offset(disparity_px: float, sign: int) -> None:
    left, right = spots(disparity_px)
    x, y = np.rint(grid() - ([0, 0] if sign == 1 else [disparity_px, 0])).astype(np.int64).T.copy()
    images = (left, right) if sign == 1 else (right, left)
    expected_px = np.full(len(x), disparity_px + 0.8)
    found = search_rows(*images, Pixels(x, y, y, expected_px, np.zeros(len(x))), SEARCH_PX, sign)
    error = found.disparity_px - disparity_px
    assert np.isfinite(error).all()
    assert np.abs(np.median(error)) < 0.01 and np.median(np.abs(error)) < 0.03 and np.abs(error).max() < 0.2
    assert found.correlation.min() > 0.95 and (found.expected > found.elsewhere).all()


def test_a_pixel_beside_a_depth_edge_has_the_disparity_of_its_own_surface() -> None:
    """Where the gray values of the surfaces differ, the window weighs those of the surface of the pixel."""
    rng = np.random.default_rng(3)
    far, near = rng.integers(20, 60, (HEIGHT, WIDTH + 40)), rng.integers(180, 220, (HEIGHT, WIDTH + 40))
    columns = np.arange(WIDTH)
    left = np.where(columns < 90, near[:, :WIDTH], far[:, :WIDTH]).astype(np.uint8)
    right = np.where(columns < 90 - 15, near[:, 15 : WIDTH + 15], far[:, 4 : WIDTH + 4]).astype(np.uint8)
    rows = np.arange(20, 70, dtype=np.int64)
    for x, expected_px in ((88, 15.0), (93, 4.0)):
        columns, none = np.full(len(rows), x), np.zeros(len(rows))
        found = search_rows(left, right, Pixels(columns, rows, rows, none + expected_px, none), SEARCH_PX, 1)
        assert np.median(np.abs(found.disparity_px - expected_px)) < 0.02
        assert np.mean(found.expected > found.elsewhere + 0.1) > 0.95


def test_wrong_repeated_and_one_sided_matches_are_rejected() -> None:
    left, right = spots(9.25)
    xy = grid()
    good = check_corners(left, right, xy, xy - [9.6, 0], SEARCH_PX, unique=True)
    assert np.mean(good.reasons == 0) > 0.95
    np.testing.assert_allclose(good.disparity_px[good.reasons == 0], 9.25, atol=0.2)
    wrong = check_corners(left, right, xy, xy - [14.0, 0], SEARCH_PX, unique=False)
    assert np.mean(wrong.reasons == Reason.NO_MATCH) > 0.95
    ours = np.tile(left[:, 60:72], (1, 15))[:, :WIDTH].copy()  # with a period of 12 px
    repeated = check_corners(ours, ours, xy, xy - [12.0, 0], SEARCH_PX, unique=True)
    assert (repeated.reasons == Reason.UNIQUENESS).all()
    allowed = check_corners(ours, ours, xy, xy - [12.0, 0], SEARCH_PX, unique=False)
    assert np.mean(allowed.reasons == 0) > 0.95
    twice = left.copy()
    twice[:, 100:130] = left[:, 88:118]  # the right image has these columns once
    one_sided = check_corners(twice, right, xy, xy - [9.25, 0], SEARCH_PX, unique=True)
    inside = (xy[:, 0] > 106) & (xy[:, 0] < 111)
    assert (one_sided.reasons[inside] != 0).all()


def test_corners_agree_with_most_of_their_neighbors() -> None:
    rng = np.random.default_rng(2)
    xy = rng.uniform(0, 400, (300, 2))
    slanted = 10 + 0.05 * xy[:, 0] + 0.02 * xy[:, 1]
    assert agree_with_neighbors(xy, slanted).all()
    single = slanted.copy()
    single[[7, 90, 200]] += 6
    agree = agree_with_neighbors(xy, single)
    assert set(np.flatnonzero(~agree)) == {7, 90, 200}
    step = np.where(xy[:, 0] < 200, slanted, slanted + 12)
    agree = agree_with_neighbors(xy, step)
    distance_px = np.abs(xy[:, 0] - 200)
    assert agree[distance_px > 70].all() and not agree[distance_px < 10].all()
    for n, at in enumerate(xy):
        away = np.hypot(*(xy - at).T)
        others = np.argsort(away)[1:17]
        share = np.mean(np.abs(step[others] - step[n]) <= 1 + 0.08 * away[others])
        assert agree[n] == (share >= 0.75)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_few_corners_are_all_kept(count: int) -> None:
    assert agree_with_neighbors(np.arange(2.0 * count).reshape(-1, 2), np.arange(0.0, 50 * count, 50)).all()

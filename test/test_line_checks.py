# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matched lines and the surfaces beside them: a textured bar in front of a textured wall."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.matching.features.line_checks import check_lines
from stereo_depth_ros.matching.features.matcher import FeatureMatcher

HEIGHT, WIDTH = 80, 160
BAR, BAR_PX, WALL_PX = (70, 100), 14, 6
SEARCH_PX = (0, 31)


def bar_before_wall() -> tuple[U8, U8]:
    rng = np.random.default_rng(4)
    wall, bar = (
        cv2.GaussianBlur(rng.normal(gray, 40, (HEIGHT, WIDTH + 20)), (5, 5), 1.2).clip(0, 255) for gray in (60, 190)
    )
    columns = np.arange(WIDTH)
    left = np.where((columns >= BAR[0]) & (columns < BAR[1]), bar[:, :WIDTH], wall[:, :WIDTH])
    inside = (columns >= BAR[0] - BAR_PX) & (columns < BAR[1] - BAR_PX)
    right = np.where(inside, bar[:, BAR_PX : WIDTH + BAR_PX], wall[:, WALL_PX : WIDTH + WALL_PX])
    return left.astype(np.uint8), right.astype(np.uint8)


def upright(*x: float) -> tuple[np.ndarray, F64]:
    """Segments in rows 10 to 69: number and position of each point."""
    rows = np.arange(10.0, 70.0)
    segment = np.repeat(np.arange(len(x)), len(rows))
    return segment, np.stack((np.repeat(x, len(rows)), np.tile(rows, len(x))), axis=1)


def test_sides_that_move_with_the_line() -> None:
    left, right = bar_before_wall()
    # both edges of the bar, a line on the bar, one on the wall, and the right edge with the disparity of nothing
    segment, xy = upright(BAR[0] - 0.5, BAR[1] - 0.5, 85.0, 125.0, BAR[1] - 0.5)
    disparity_px = np.array([BAR_PX, BAR_PX, BAR_PX, WALL_PX, 20.0])[segment]
    sides = check_lines(left, right, segment, xy, disparity_px, SEARCH_PX)
    np.testing.assert_array_equal(sides.smaller, [False, True, True, True, False])
    np.testing.assert_array_equal(sides.larger, [True, False, True, True, False])


def test_lines_that_go_into_the_depth() -> None:
    """The windows follow the disparity from row to row."""
    rng = np.random.default_rng(2)
    texture = cv2.GaussianBlur(rng.normal(128, 60, (HEIGHT, WIDTH + 40)), (5, 5), 1.5).astype(np.float32)
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    left = texture[:, :WIDTH].clip(0, 255).astype(np.uint8)
    right = cv2.remap(texture, u + 4 + 0.2 * v, v, cv2.INTER_LINEAR).clip(0, 255).astype(np.uint8)
    segment, xy = upright(60.0, 110.0)
    disparity_px = 4 + 0.2 * xy[:, 1]
    sides = check_lines(left, right, segment, xy, disparity_px, SEARCH_PX)
    assert sides.smaller.all() and sides.larger.all()
    sides = check_lines(left, right, segment, xy, np.full(len(xy), 12.0), SEARCH_PX)
    assert not sides.smaller.any() and not sides.larger.any()


def test_points_of_a_depth_edge_are_on_the_near_surface() -> None:
    left, right = bar_before_wall()
    result = FeatureMatcher(MatchingConfig(num_disparities=32, feature_type="lines")).match(left, right)
    rows, columns = np.nonzero(np.abs(result.disparity_px - BAR_PX) < 0.6)
    assert len(rows) > 80
    on_bar = (columns >= BAR[0]) & (columns < BAR[1])
    assert on_bar.mean() > 0.98
    edges = np.minimum(np.abs(columns - BAR[0] + 0.5), np.abs(columns - BAR[1] + 0.5))
    assert np.median(edges) == pytest.approx(2, abs=0.6)


def test_no_segments() -> None:
    left, right = bar_before_wall()
    sides = check_lines(left, right, np.zeros(0, np.intp), np.empty((0, 2)), np.empty(0), SEARCH_PX)
    assert len(sides.smaller) == len(sides.larger) == 0

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Line segments: where drawn edges are found, and the similarity against its formula."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.features import line_segments
from stereo_depth_ros.matching.features.line_segments import LineSegments, common_rows, detect_segments, line_similarity

OVERSAMPLING = 8


def edge_image(height: int, width: int, edges: list[tuple[float, float, int, int]]) -> U8:
    """Bands of rows, one for each edge x = x0 + slope * y, with one gray value on its left and one on its right."""
    y, x = (np.indices((height * OVERSAMPLING, width * OVERSAMPLING)) + 0.5) / OVERSAMPLING - 0.5
    band = np.minimum((y + 0.5) * len(edges) / height, len(edges) - 1e-6).astype(int)
    x0, slope, left, right = np.array(edges).T[:, band]
    fine = np.where(x < x0 + slope * y, left, right).astype(np.float32)
    return cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)


def segments(*ends: tuple[float, float, float, float], contrast: float = 0.0) -> LineSegments:
    """Segments from x, y of the upper and x, y of the lower end."""
    return LineSegments(np.array(ends, np.float64).reshape(-1, 2, 2), np.full(len(ends), contrast))


@pytest.mark.parametrize(
    ("x0", "slope", "left", "right"), [(60.3, 0.3, 60, 180), (90.8, -0.6, 200, 90), (71.25, 0.0, 40, 240)]
)
def test_a_drawn_edge_is_found(x0: float, slope: float, left: int, right: int) -> None:
    found = detect_segments(edge_image(90, 170, [(x0, slope, left, right)]))
    assert len(found) == 1
    rows = np.array([10.0, 45.0, 80.0])
    # The fit to an image of gray values; pixel centers taken wrongly would be 0.125 px in x and in y.
    np.testing.assert_allclose([found.columns(row)[0] for row in rows], x0 + slope * rows, atol=0.06)
    assert found.orientation[0] == pytest.approx(math.atan2(1, slope), abs=math.radians(0.5))
    # It stops a pixel or two before the border of the image.
    assert found.height[0] == pytest.approx(89, abs=3)
    assert found.length[0] == pytest.approx(found.height[0] * math.hypot(1, slope), rel=1e-2)
    assert found.midpoint[0] == pytest.approx((x0 + slope * 44.5, 44.5), abs=1.5)
    assert found.contrast[0] == pytest.approx(left - right, abs=1.0)  # 2 px beside the edge all is flat


def test_upper_end_is_first_and_flat_or_short_edges_are_skipped() -> None:
    image = np.full((120, 200), 50, np.uint8)
    cv2.fillPoly(image, [np.array([[20, 20], [180, 40], [150, 100], [60, 90]])], 200)  # upper and lower side are flat
    image[5:12, 100:107] = 220  # sides of 7 px
    found = detect_segments(image)
    assert len(found) == 2
    assert (found.ends[:, 0, 1] < found.ends[:, 1, 1]).all()
    order = np.argsort(found.midpoint[:, 0])
    expected = [math.atan2(70, 40), math.atan2(60, -30)]
    np.testing.assert_allclose(found.orientation[order], expected, atol=math.radians(2))
    assert (np.sign(found.contrast[order]) == [-1, 1]).all()


def test_image_without_edges_has_no_segments() -> None:
    found = detect_segments(np.full((60, 80), 70, np.uint8))
    assert len(found) == 0
    assert line_similarity(found, found, 0, 31).shape == (0, 0)


def test_columns_and_points_lie_on_the_line() -> None:
    found = segments((10, 20, 30, 60), (50, 10, 50, 90))
    np.testing.assert_allclose(found.columns(np.array([40.0, 17.0])), [20, 50])
    np.testing.assert_allclose(found.columns(np.array([[20.0], [60.0]])), [[10, 50], [30, 50]])
    np.testing.assert_allclose(
        found.take(np.array([1, 0, 0])).at(np.array([11, 20, 21])), [[50, 11], [10, 20], [10.5, 21]]
    )


def test_common_rows_are_the_overlap() -> None:
    first, last = common_rows(segments((10, 20, 30, 60), (50, 10, 50, 30)), segments((5, 25, 5, 90), (5, 70, 5, 80)))
    np.testing.assert_array_equal(first, [[25, 70], [25, 70]])
    np.testing.assert_array_equal(last, [[60, 60], [30, 30]])


def weights(
    monkeypatch: pytest.MonkeyPatch, length: float, orientation: float, midpoint: float, contrast: float
) -> None:
    """Makes the weights of the four terms these."""
    names = ("LENGTH_SIGMA_PX", "ORIENTATION_SIGMA_RAD", "MIDPOINT_SIGMA_PX", "CONTRAST_SIGMA")
    for name, weight in zip(names, (length, orientation, midpoint, contrast), strict=True):
        monkeypatch.setattr(line_segments, name, weight**-0.5 if weight else math.inf)


LEFT = segments((40, 10, 40, 60), contrast=-30)  # upright, 50 px long, midpoint (40, 35)


@pytest.mark.parametrize(
    ("right", "dissimilarity"),
    [
        (segments((33, 10, 33, 70), contrast=-30), 2 * 10**2 + 5 * 5**2),  # midpoint 5 rows lower
        (segments((33, 14, 33, 64), contrast=-23), 5 * 4**2 + 7 * 7**2),
        (segments((33, 10, 33, 60), contrast=30), 7 * 60**2),  # contrast the other way round
        (segments((52, 10, 52, 60), contrast=-30), 5 * 9**2),  # disparity -12, the search begins at -3
        (segments((3, 10, 3, 60), contrast=-30), 5 * 9**2),  # disparity 37, the search ends at 28
        (segments((30, 5, 60, 45), contrast=-30), 3 * math.atan2(3, 4) ** 2 + 5 * (10**2 + 2**2)),  # midpoint (45, 25)
    ],
)
def test_similarity_is_the_formula(monkeypatch: pytest.MonkeyPatch, right: LineSegments, dissimilarity: float) -> None:
    weights(monkeypatch, 2, 3, 5, 7)
    np.testing.assert_allclose(1 / line_similarity(LEFT, right, -3, 28), [[dissimilarity]])


def test_equal_segments_at_an_allowed_disparity_are_infinitely_similar() -> None:
    right = segments((40 - 17, 10, 40 - 17, 60), contrast=-30)
    assert np.isinf(line_similarity(LEFT, right, 0, 31)).all()
    assert np.isfinite(line_similarity(LEFT, right, 0, 16)).all()


def test_orientations_are_those_of_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    weights(monkeypatch, 0, 1, 0, 0)
    down_right, down_left = segments((0, 0, 100, 2)), segments((100, 0, 0, 2))
    expected = (2 * math.atan2(2, 100)) ** 2  # not nearly pi
    np.testing.assert_allclose(1 / line_similarity(down_right, down_left, 0, 31), [[expected]])


def test_similarities_of_many_are_those_of_each() -> None:
    rng = np.random.default_rng(2)
    ends = rng.uniform((0, 0), (90, 40), (9, 2, 2)) + np.array([[0, 0], [0, 50]])
    many = LineSegments(ends, rng.uniform(-90, 90, 9))
    left, right = many.take(np.arange(4)), many.take(np.arange(4, 9))
    found = line_similarity(left, right, 2, 33)
    assert found.shape == (4, 5)
    for i in range(4):
        for j in range(5):
            one = line_similarity(left.take(np.array([i])), right.take(np.array([j])), 2, 33)
            assert found[i, j] == pytest.approx(one[0, 0], rel=1e-12)

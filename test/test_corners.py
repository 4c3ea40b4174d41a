# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Corner detection with sub-pixel conventions, descriptor distances and mutual best pairs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.matching.features.corners import (
    detect_fast,
    detect_orb,
    detect_sift,
    mutual_best,
    squared_distances,
    squared_distances_of_pairs,
)
from stereo_depth_ros.matching.features.lucas_kanade import refine_right_points


def blob(x: float, y: float, shape: tuple[int, int] = (90, 120)) -> U8:
    rows, columns = np.indices(shape)
    gray = 40 + 180 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 3.0**2))
    return gray.round().astype(np.uint8)


def texture(seed: int = 0, shape: tuple[int, int] = (120, 160)) -> U8:
    noise = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return cv2.normalize(smooth, None, 10, 245, cv2.NORM_MINMAX).astype(np.uint8)


@pytest.mark.parametrize("center", [(57.0, 41.0), (57.3, 41.6)])
def test_sift_positions_have_pixel_centers_at_whole_numbers(center: tuple[float, float]) -> None:
    xy, descriptors = detect_sift(blob(*center), 10)
    assert descriptors.shape == (len(xy), 128)
    np.testing.assert_allclose(xy[np.abs(xy - center).sum(axis=1).argmin()], center, atol=0.05)


def test_orb_and_fast_give_bits() -> None:
    for xy, bits in (detect_orb(texture(), 50, 10), detect_fast(texture(), 7, (3, 4), 5)):
        assert len(xy) == len(bits) > 0
        assert bits.shape[1] == 256 and set(np.unique(bits)) == {0.0, 1.0}


def test_fast_takes_the_strongest_of_each_cell() -> None:
    image = texture(3)
    xy, _ = detect_fast(image, 7, (2, 3), 4)
    responses = {keypoint.pt: keypoint.response for keypoint in cv2.FastFeatureDetector.create(7).detect(image)}
    cells: dict[tuple[int, int], list[float]] = {}
    for (x, y), response in responses.items():
        cells.setdefault((int(2 * y / 120), int(3 * x / 160)), []).append(response)
    assert len(cells) == 6 and min(map(len, cells.values())) > 4
    for x, y in xy:  # ORB does not describe corners near the border
        strongest = sorted(cells[int(2 * y / 120), int(3 * x / 160)])[-4:]
        assert responses[x, y] in strongest
    assert len(xy) <= 6 * 4


def test_without_corners() -> None:
    flat = np.full((60, 80), 90, np.uint8)
    assert detect_sift(flat, 10)[1].shape == (0, 128)
    assert detect_orb(flat, 10, 10)[1].shape == detect_fast(flat, 7, (2, 2), 3)[1].shape == (0, 256)


def test_distances_by_their_definition() -> None:
    random = np.random.default_rng(1)
    left, right = (random.integers(0, 256, (n, 128)).astype(np.float32) for n in (7, 9))
    expected = ((left[:, None].astype(np.int64) - right) ** 2).sum(axis=2)
    np.testing.assert_array_equal(squared_distances(left, right), expected)
    i, j = np.nonzero(expected % 2)
    np.testing.assert_array_equal(squared_distances_of_pairs(left, right, i, j), expected[i, j])


def test_mutual_best() -> None:
    cost: F32 = np.array([[1, 5, 9], [2, 4, 9], [np.inf, 7, 8], [np.inf, np.inf, np.inf]], np.float32)
    assert [each.tolist() for each in mutual_best(cost, 0.8)] == [[0], [0]]
    cost[0, 0] = np.inf  # then row 1 wins column 0, by 2 against 4; row 0 has one candidate left, which row 1 beats
    assert [each.tolist() for each in mutual_best(cost, 0.8)] == [[1], [0]]
    assert [each.tolist() for each in mutual_best(cost, 0.5)] == [[], []], "2 is not below half of 4"


def test_lucas_kanade_moves_right_points_to_the_left_ones() -> None:
    image, shift = texture(5), np.array([13, -10]) / 32  # warpAffine of OpenCV 4 rounds to 1/32 px
    moved = cv2.warpAffine(image, np.array([[1, 0, shift[0]], [0, 1, shift[1]]]), (160, 120), flags=cv2.INTER_CUBIC)
    points = np.array([[50.0, 40.0], [110.0, 75.0], [71.0, 90.0]])
    right, refined = refine_right_points(image, moved, points, points, window_px=15, max_move_px=1.0)
    assert refined.all()
    np.testing.assert_allclose(right, points + shift, atol=0.05)
    assert not refine_right_points(image, moved, points, points, window_px=15, max_move_px=0.35)[1].any()


def test_lucas_kanade_tracks_back() -> None:
    image, other = texture(5), texture(6)
    points = np.array([[50.0, 40.0], [110.0, 75.0], [71.0, 90.0]])
    options = {"window_px": 15, "max_move_px": 5.0}
    assert refine_right_points(image, image, points, points, max_return_px=0.1, **options)[1].all()
    assert not refine_right_points(image, other, points, points, max_return_px=0.01, **options)[1].all()

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Matches of raw images, and their undistorted points."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from two_views import K_LEFT, SIZE

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.geometry.correspondences import Correspondences, match_features
from stereo_depth_ros.geometry.rays import undistort_points


def camera(model: str, D: list[float]) -> CameraModel:
    return CameraModel(*SIZE, model, K_LEFT, np.array(D), np.identity(3), np.identity(4)[:3])


def texture() -> U8:
    """Different blobs of several sizes."""
    random = np.random.default_rng(5)
    octaves = [cv2.resize(random.random((240 // k, 320 // k)), (320, 240), interpolation=2) for k in (4, 8, 16)]
    image: U8 = cv2.normalize(sum(octaves), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    return image


def mapped(H: F64, points: F64) -> F64:
    moved: F64 = cv2.perspectiveTransform(points[:, None], H)[:, 0]
    return moved


def test_matches_of_an_image_and_its_warp() -> None:
    """A rotation, a zoom and a tilt: positions within a fraction of a pixel, without a bias in any direction."""
    left = texture()
    H = np.array([[1.05, -0.06, 9.3], [0.08, 1.02, -7.6], [1e-4, -5e-5, 1.0]])
    right = cv2.warpPerspective(left, H, (300, 260), flags=cv2.INTER_CUBIC)
    matches = match_features(left, right)
    error = matches.right_px - mapped(H, matches.left_px)
    assert len(matches) > 150
    assert np.median(np.linalg.norm(error, axis=1)) < 0.15
    assert np.abs(np.median(error, axis=0)).max() < 0.03
    assert np.mean(np.linalg.norm(error, axis=1) < 2) > 0.97


def test_matches_are_deterministic_and_unique() -> None:
    left = texture()
    right = np.roll(left, (3, -8), axis=(0, 1))
    first, second = match_features(left, right), match_features(left, right)
    np.testing.assert_array_equal(first.left_px, second.left_px)
    np.testing.assert_array_equal(first.right_px, second.right_px)
    both = np.hstack((first.left_px, first.right_px))
    assert len(np.unique(both, axis=0)) == len(both)


def test_images_with_nothing_in_common() -> None:
    assert len(match_features(np.full((60, 80), 90, np.uint8), texture())) == 0


def test_images_that_are_not_gray() -> None:
    gray = texture()
    with pytest.raises(ImageError, match=r"left image: float32 of shape \(240, 320\)"):
        match_features(gray.astype(np.float32), gray)
    with pytest.raises(ImageError, match=r"right image: uint8 of shape \(240, 320, 3\).*convert it to gray"):
        match_features(gray, cv2.merge([gray, gray, gray]))


def test_different_numbers_of_points() -> None:
    with pytest.raises(ImageError, match=r"\(3, 2\) and \(4, 2\)"):
        Correspondences(np.zeros((3, 2)), np.zeros((4, 2)))


def test_points_that_no_pinhole_sees_are_removed() -> None:
    """Of a fisheye, a point 95 degrees off the axis."""
    side = camera("equidistant", [0.0, 0.0, 0.0, 1e-9])
    beyond = np.array([side.K[0, 2] + side.K[0, 0] * np.radians(95), side.K[1, 2]])
    matches = Correspondences(np.vstack((beyond, [100.0, 90.0])), np.array([[90.0, 80.0], [91.0, 81.0]]))
    assert np.isnan(undistort_points(matches.left_px, side)[0]).all()
    left_over = matches.undistorted(side, camera("plumb_bob", [0.0] * 5))
    np.testing.assert_allclose(left_over.right_px, [[91.0, 81.0]])


def test_take() -> None:
    matches = Correspondences(np.arange(8.0).reshape(4, 2), np.arange(8.0, 16.0).reshape(4, 2))
    np.testing.assert_array_equal(matches.take(np.array([True, False, False, True])).left_px, [[0, 1], [6, 7]])
    np.testing.assert_array_equal(matches.take(np.array([2, 0])).right_px, [[12, 13], [8, 9]])

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The eight-point algorithm: exact matches, noise, OpenCV, and degenerate points."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from two_views import F_TRUE, K_LEFT, K_RIGHT, POSE, plane_views, views

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.eight_point import eight_point, enforce_rank_2, unit_scale
from stereo_depth_ros.geometry.epipolar import camera_coordinates, epipoles, sampson_distance
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.geometry.sampson_refinement import refine_fundamental

CLEAN = views(300, seed=99)


def error_px(F: F64) -> float:
    """Distance of exact matches from F."""
    return float(sampson_distance(F, CLEAN.left_px, CLEAN.right_px).mean())


@pytest.mark.parametrize("count", [8, 9, 57])
def test_exact_matches_give_the_matrix(count: int) -> None:
    seen = views(count, seed=count)
    F = eight_point(seen.left_px, seen.right_px)
    np.testing.assert_allclose(F, unit_scale(F_TRUE), atol=1e-9)
    assert error_px(F) < 1e-9


def test_properties_hold_with_noise() -> None:
    noisy = views(40, noise_px=1.0)
    F = eight_point(noisy.left_px, noisy.right_px)
    assert np.linalg.norm(F) == pytest.approx(1)
    assert F.ravel()[np.abs(F).argmax()] > 0
    left, right = epipoles(F)
    assert abs(np.linalg.det(F)) < 1e-18
    assert np.abs(F @ left).max() < 1e-12
    assert np.abs(right @ F).max() < 1e-12


def test_the_same_least_squares_as_opencv() -> None:
    noisy = views(80, noise_px=0.6, seed=5)
    theirs = cv2.findFundamentalMat(noisy.left_px, noisy.right_px, cv2.FM_8POINT)[0]
    ours = eight_point(noisy.left_px, noisy.right_px)
    # OpenCV scales the mean distance, not its square, to sqrt(2): the same up to a few thousandths
    np.testing.assert_allclose(ours, unit_scale(theirs), atol=5e-3)
    assert error_px(ours) < 1.1 * error_px(theirs)


def test_camera_coordinates_give_the_essential_matrix() -> None:
    seen = views(30, seed=2)
    E = eight_point(camera_coordinates(seen.left_px, K_LEFT), camera_coordinates(seen.right_px, K_RIGHT))
    np.testing.assert_allclose(E, unit_scale(POSE.essential), atol=1e-12)


def test_errors_fall_as_the_root_of_the_number() -> None:
    """Four times the matches halve the error; over 20 draws each, the ratio of two means is known to about 15 %."""
    eight, refined = np.array([_mean_errors(count) for count in (60, 240, 960)]).T
    for errors in (eight, refined):
        assert errors[0] / errors[1] == pytest.approx(2, rel=0.3)
        assert errors[1] / errors[2] == pytest.approx(2, rel=0.3)
    assert (refined < 0.97 * eight).all()


def _mean_errors(count: int) -> tuple[float, float]:
    """Root mean squares over draws, of the eight-point solution and of its refinement by Sampson distance."""
    squares = []
    for seed in range(20):
        noisy = views(count, noise_px=0.5, seed=seed)
        F = eight_point(noisy.left_px, noisy.right_px)
        squares.append((error_px(F) ** 2, error_px(refine_fundamental(F, noisy.left_px, noisy.right_px)) ** 2))
    eight, refined = np.sqrt(np.mean(squares, axis=0))
    return float(eight), float(refined)


def test_refinement_reaches_a_minimum_with_rank_2() -> None:
    noisy = views(70, noise_px=0.8, seed=4)
    start = eight_point(noisy.left_px, noisy.right_px)
    F = refine_fundamental(start, noisy.left_px, noisy.right_px)
    cost = _cost(F, noisy.left_px, noisy.right_px)
    assert abs(np.linalg.det(F)) < 1e-18
    assert cost < _cost(start, noisy.left_px, noisy.right_px)
    random = np.random.default_rng(1)
    for _ in range(50):
        nearby = enforce_rank_2(F * (1 + 1e-3 * random.standard_normal((3, 3))))
        assert _cost(nearby, noisy.left_px, noisy.right_px) > cost


def _cost(F: F64, left_px: F64, right_px: F64) -> float:
    return float((sampson_distance(F, left_px, right_px) ** 2).sum())


def test_rank_2_is_the_nearest() -> None:
    full = np.array([[2.0, 0.3, -1.0], [0.5, 1.5, 0.2], [-0.4, 0.6, 3.0]])
    nearest = enforce_rank_2(full)
    singular = np.linalg.svd(full, compute_uv=False)
    np.testing.assert_allclose(np.linalg.svd(nearest, compute_uv=False), [*singular[:2], 0], atol=1e-14)
    assert np.linalg.norm(full - nearest) == pytest.approx(singular[2])


def test_fewer_than_eight() -> None:
    seen = views(7)
    with pytest.raises(CalibrationError, match=r"7 different matches of 7.*needs 8.*use matches"):
        eight_point(seen.left_px, seen.right_px)
    thrice = np.tile(seen.left_px, (3, 1)), np.tile(seen.right_px, (3, 1))
    with pytest.raises(CalibrationError, match="7 different matches of 21"):
        eight_point(*thrice)


def test_coincident() -> None:
    seen = views(20)
    same = np.broadcast_to([312.25, 97.5], (20, 2))
    with pytest.raises(CalibrationError, match="the 20 left points are coincident"):
        eight_point(same, seen.right_px)
    with pytest.raises(CalibrationError, match="the 20 right points are coincident"):
        eight_point(seen.left_px, same)


def test_collinear() -> None:
    seen = views(20)
    on_line = np.column_stack((seen.left_px[:, 0], 0.3 * seen.left_px[:, 0] + 40))
    with pytest.raises(CalibrationError, match=r"left points are collinear.*limit 0\.01"):
        eight_point(on_line, seen.right_px)


@pytest.mark.parametrize(("count", "noise_px"), [(8, 0.0), (8, 1.0), (9, 1.0), (30, 0.0), (30, 0.5), (300, 1.0)])
def test_points_of_one_plane(count: int, noise_px: float) -> None:
    for seed in range(5):
        plane = plane_views(count, noise_px, seed)
        with pytest.raises(CalibrationError, match="coplanar"):
            eight_point(plane.left_px, plane.right_px)


@pytest.mark.parametrize("noise_px", [0.0, 0.3])
def test_a_camera_that_only_rotated(noise_px: float) -> None:
    turned = views(40, noise_px, pose=RelativePose(POSE.R, 1e-9 * POSE.t))
    with pytest.raises(CalibrationError, match="only rotated"):
        eight_point(turned.left_px, turned.right_px)


def test_invalid_points() -> None:
    seen = views(12)
    with pytest.raises(CalibrationError, match=r"shapes \(12, 2\) and \(11, 2\)"):
        eight_point(seen.left_px, seen.right_px[:11])
    holed = seen.left_px.copy()
    holed[3, 1] = np.nan
    with pytest.raises(CalibrationError, match="points that are not finite: remove them"):
        eight_point(holed, seen.right_px)


def test_usual_scenes_are_not_refused() -> None:
    for seed in range(20):
        noisy = views(30, noise_px=0.5, seed=seed)
        eight_point(noisy.left_px, noisy.right_px)

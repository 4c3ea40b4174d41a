# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Triangulation: exact points, OpenCV, optimal matches, invalid points."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from two_views import F_TRUE, K_LEFT, K_RIGHT, POSE, project, views

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.eight_point import unit_scale
from stereo_depth_ros.geometry.epipolar import homogeneous, sampson_distance
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.geometry.triangulation import (
    fundamental_from_cameras,
    optimal_matches,
    parallax,
    triangulate_linear,
    triangulate_midpoint,
    triangulate_optimal,
)

P_LEFT = K_LEFT @ np.identity(4)[:3]
P_RIGHT = K_RIGHT @ np.column_stack((POSE.R, POSE.t))
EXACT = views(50)
NOISY = views(50, noise_px=0.8, seed=3)


def metric(X: F64) -> F64:
    points: F64 = X[:, :3] / X[:, 3:]
    return points


@pytest.mark.parametrize("triangulate", [triangulate_linear, triangulate_optimal])
def test_exact_matches_give_the_points(triangulate) -> None:  # type: ignore[no-untyped-def]
    X = triangulate(P_LEFT, P_RIGHT, EXACT.left_px, EXACT.right_px)
    np.testing.assert_allclose(metric(X), EXACT.points_m, rtol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(X, axis=1), 1)
    assert (X @ P_LEFT[2] > 0).all()


def test_rectified_pairs_by_the_closed_form() -> None:
    """X = (x - cx) Z / f and so on, against the general method."""
    rig = StereoRig.from_rectified(410.0, 420.0, 330.0, 318.0, 205.0, 0.12, (640, 430))
    random = np.random.default_rng(2)
    left = random.uniform((50, 20), (600, 400), (40, 2))
    right = left - np.column_stack((random.uniform(rig.doffs_px + 1, 60, 40), np.zeros(40)))
    closed = Triangulation.from_rig(rig).points(left, right)
    general = triangulate_linear(rig.left.P, rig.right.P, left, right)
    np.testing.assert_allclose(closed, metric(general), rtol=1e-6)


def test_behind_infinity_the_closed_form_has_no_point() -> None:
    rig = StereoRig.from_rectified(410.0, 420.0, 330.0, 318.0, 205.0, 0.12, (640, 430))
    at, beyond = (np.array([[200.0 - rig.doffs_px + more, 100.0]]) for more in (0.0, 2.0))
    assert np.isnan(Triangulation.from_rig(rig).points(np.array([[200.0, 100]]), at)).all()
    assert np.isnan(Triangulation.from_rig(rig).points(np.array([[200.0, 100]]), beyond)).all()


def test_midpoint_of_rays_that_intersect() -> None:
    left, right = (
        homogeneous(px) @ np.linalg.inv(K).T for px, K in ((EXACT.left_px, K_LEFT), (EXACT.right_px, K_RIGHT))
    )
    np.testing.assert_allclose(triangulate_midpoint(POSE, 3 * left, 0.2 * right), EXACT.points_m, rtol=1e-9)


def test_midpoint_of_rays_that_miss_each_other() -> None:
    """One along z through the origin, one along -x with y offset by 0.2: the midpoint is known."""
    turn = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])  # the right camera looks along x of the left one
    pose = RelativePose(turn, -turn @ np.array([-1.0, 0.2, 2.0]))
    middle = triangulate_midpoint(pose, np.array([[0.0, 0, 1]]), np.array([[0.0, 0, 1]]))
    np.testing.assert_allclose(middle, [[0, 0.1, 2]], atol=1e-12)
    away = triangulate_midpoint(pose, np.array([[0.0, 0, 1]]), np.array([[0.0, 0, -1]]))
    parallel = triangulate_midpoint(POSE, np.array([[0.1, 0, 1]]), (POSE.R @ [0.1, 0, 1])[None])
    assert np.isnan(away).all()
    assert np.isnan(parallel).all()


def test_linear_against_opencv() -> None:
    theirs = cv2.triangulatePoints(P_LEFT, P_RIGHT, EXACT.left_px.T, EXACT.right_px.T).T
    ours = triangulate_linear(P_LEFT, P_RIGHT, EXACT.left_px, EXACT.right_px)
    np.testing.assert_allclose(metric(ours), metric(theirs), rtol=1e-6)


def test_optimal_matches_against_opencv() -> None:
    """The roots of Hartley and Sturm's polynomial."""
    left, right = cv2.correctMatches(F_TRUE, NOISY.left_px[None], NOISY.right_px[None])
    nearest = optimal_matches(F_TRUE, NOISY.left_px, NOISY.right_px)
    np.testing.assert_allclose(nearest.left_px, left[0], atol=1e-3)
    np.testing.assert_allclose(nearest.right_px, right[0], atol=1e-3)
    ours, theirs = (
        np.sum((a - NOISY.left_px) ** 2, axis=1) + np.sum((b - NOISY.right_px) ** 2, axis=1)
        for a, b in ((nearest.left_px, nearest.right_px), (left[0], right[0]))
    )
    assert (ours <= theirs + 1e-6).all()
    assert sampson_distance(F_TRUE, nearest.left_px, nearest.right_px).max() < 1e-8


def test_optimal_matches_of_a_rectified_pair() -> None:
    """Where Hartley and Sturm's method fails: both rows move to their mean."""
    F = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    nearest = optimal_matches(F, np.array([[80.0, 31.0]]), np.array([[70.0, 32.0]]))
    np.testing.assert_allclose(nearest.left_px, [[80, 31.5]], atol=1e-9)
    np.testing.assert_allclose(nearest.right_px, [[70, 31.5]], atol=1e-9)


def test_optimal_points_have_the_least_reprojection_error() -> None:
    def miss(X: F64) -> float:
        seen = [homogeneous_px(X, P) for P in (P_LEFT, P_RIGHT)]
        return float(
            sum(np.sum((each - px) ** 2) for each, px in zip(seen, (NOISY.left_px, NOISY.right_px), strict=True))
        )

    optimal = triangulate_optimal(P_LEFT, P_RIGHT, NOISY.left_px, NOISY.right_px)
    linear = triangulate_linear(P_LEFT, P_RIGHT, NOISY.left_px, NOISY.right_px)
    assert miss(optimal) < miss(linear)
    random = np.random.default_rng(0)
    for _ in range(20):
        assert miss(optimal * (1 + 1e-5 * random.standard_normal(optimal.shape))) > miss(optimal)


def homogeneous_px(X: F64, P: F64) -> F64:
    seen: F64 = X @ P.T
    return seen[:, :2] / seen[:, 2:]


def test_optimal_points_do_not_depend_on_the_frame() -> None:
    """Cameras and points transformed by a homography of space give the same images."""
    H = np.identity(4) + 0.2 * np.random.default_rng(4).standard_normal((4, 4))
    there = triangulate_optimal(P_LEFT @ H, P_RIGHT @ H, NOISY.left_px, NOISY.right_px) @ H.T
    here = triangulate_optimal(P_LEFT, P_RIGHT, NOISY.left_px, NOISY.right_px)
    np.testing.assert_allclose(metric(there), metric(here), rtol=1e-6)


def test_errors_are_proportional_to_the_noise() -> None:
    def error(noise_px: float) -> float:
        seen = views(400, noise_px, seed=5)
        X = metric(triangulate_optimal(P_LEFT, P_RIGHT, seen.left_px, seen.right_px))
        return float(np.sqrt(np.mean(((X - seen.points_m)[:, 2] / seen.points_m[:, 2] ** 2) ** 2)))

    assert error(0.4) / error(0.1) == pytest.approx(4, rel=0.1)


def test_fundamental_matrix_of_cameras() -> None:
    np.testing.assert_allclose(unit_scale(fundamental_from_cameras(P_LEFT, P_RIGHT)), unit_scale(F_TRUE), atol=1e-12)


def test_parallax() -> None:
    pose = RelativePose(np.identity(3), np.array([-0.4, 0, 0]))
    points = np.array([[0.2, 0, 3.0, 1], [0.0, 0, 1, 0], [0.1, 0, 0, 1]])
    angles = parallax(points, pose)
    assert angles[0] == pytest.approx(2 * np.arctan(0.2 / 3))
    assert angles[1] == 0
    assert angles[2] == pytest.approx(np.pi)  # between the cameras the rays are opposite


def test_matches_that_have_no_point() -> None:
    holed = EXACT.left_px.copy()
    holed[3] = np.nan
    X = triangulate_linear(P_LEFT, P_RIGHT, holed, EXACT.right_px)
    assert np.isnan(X[3]).all()
    assert np.isfinite(np.delete(X, 3, axis=0)).all()
    # Both rays along the baseline
    left, right = project(POSE.right_center[None], K_LEFT), project(POSE.t[None], K_RIGHT)
    assert np.isnan(triangulate_linear(P_LEFT, P_RIGHT, left, right)).all()


def test_points_at_infinity_have_no_last_coordinate() -> None:
    direction = np.array([[0.2, -0.1, 1.0]])
    X = triangulate_linear(P_LEFT, P_RIGHT, project(direction, K_LEFT), project(direction @ POSE.R.T, K_RIGHT))
    assert abs(X[0, 3]) < 1e-9
    np.testing.assert_allclose(X[0, :3] / X[0, 2], direction[0], atol=1e-9)

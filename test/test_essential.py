# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The essential matrix of cameras with known intrinsics, and its pose."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from two_views import F_TRUE, K_LEFT, K_RIGHT, POSE, SIZE, views

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.geometry.correspondences import match_features
from stereo_depth_ros.geometry.eight_point import eight_point, unit_scale
from stereo_depth_ros.geometry.epipolar import camera_coordinates, fundamental_from_essential, sampson_distance
from stereo_depth_ros.geometry.essential import (
    equal_singular_values,
    essential_from_fundamental,
    estimate_essential,
    pose_from_essential,
)
from stereo_depth_ros.geometry.relative_pose import RelativePose, cross_matrix
from stereo_depth_ros.geometry.sampson_refinement import refine_essential


def rays(count: int, seed: int = 0, noise_px: float = 0.0) -> tuple[F64, F64]:
    """Matches in camera coordinates."""
    seen = views(count, noise_px, seed)
    return camera_coordinates(seen.left_px, K_LEFT), camera_coordinates(seen.right_px, K_RIGHT)


def test_fundamental_and_back() -> None:
    E = essential_from_fundamental(-3 * F_TRUE, K_LEFT, K_RIGHT)
    np.testing.assert_allclose(unit_scale(E), unit_scale(POSE.essential), atol=1e-12)
    np.testing.assert_allclose(unit_scale(fundamental_from_essential(E, K_LEFT, K_RIGHT)), unit_scale(F_TRUE))


def test_singular_values_are_made_equal() -> None:
    noisy = np.array([[0.1, -2.0, 0.4], [1.7, 0.2, -0.9], [-0.3, 1.1, 0.1]])
    E = equal_singular_values(noisy)
    np.testing.assert_allclose(np.linalg.svd(E, compute_uv=False), [1, 1, 0], atol=1e-14)
    # All essential matrices satisfy 2 E E^T E = trace(E E^T) E (Demazure 1988)
    np.testing.assert_allclose(2 * E @ E.T @ E, np.trace(E @ E.T) * E, atol=1e-14)


def test_not_an_essential_matrix() -> None:
    with pytest.raises(CalibrationError, match=r"singular values .* are not those of an essential matrix"):
        equal_singular_values(np.outer([1.0, 2.0, 0.5], [0.3, -1.0, 2.0]))
    with pytest.raises(CalibrationError, match="3 x 3 and finite"):
        equal_singular_values(np.full((3, 3), np.nan))


@pytest.mark.parametrize("sign", [1.0, -2.5])
def test_pose_is_the_one_of_four_with_the_points_in_front(sign: float) -> None:
    pose = pose_from_essential(sign * POSE.essential, *rays(12))
    assert pose.up_to_scale
    assert pose.rotation_angle_to(POSE) < 1e-7
    assert pose.direction_angle_to(POSE) < 1e-7


@pytest.mark.parametrize("turned_deg", [0.0, 120.0, 170.0])
def test_pose_of_cameras_far_apart(turned_deg: float) -> None:
    """Right cameras around a small scene: the four poses then differ strongly."""
    random = np.random.default_rng(3)
    points = random.uniform(-0.5, 0.5, (40, 3)) + np.array([0.1, -0.2, 5])
    turn = cv2.Rodrigues(np.array([0.05, np.radians(turned_deg), -0.1]))[0]
    true = RelativePose(turn, np.array([0.6, 0.1, 5.0]) - turn @ np.array([0.1, -0.2, 5.0]))
    right = points @ true.R.T + true.t
    found = pose_from_essential(true.essential, points[:, :2] / points[:, 2:], right[:, :2] / right[:, 2:])
    assert found.rotation_angle_to(true) < 1e-6
    assert found.direction_angle_to(true) < 1e-6


def test_pose_against_opencv() -> None:
    left, right = rays(60, noise_px=0.4)
    E = equal_singular_values(eight_point(left, right))
    ours = pose_from_essential(E, left, right)
    _, R, t, _ = cv2.recoverPose(E, left, right, np.identity(3))
    np.testing.assert_allclose(ours.R, R, atol=1e-9)
    np.testing.assert_allclose(ours.t, t.ravel(), atol=1e-9)


def test_ambiguous_cheirality() -> None:
    """Points at infinity do not determine the sign of t."""
    far = views(30, noise_px=1.0, depth_m=(1e6, 2e6))
    left, right = camera_coordinates(far.left_px, K_LEFT), camera_coordinates(far.right_px, K_RIGHT)
    with pytest.raises(CalibrationError, match=r"cheirality is ambiguous.*of 30 points.*70 %"):
        pose_from_essential(POSE.essential, left, right)


def test_refinement_keeps_the_singular_values_and_lowers_the_cost() -> None:
    noisy = views(60, noise_px=0.6, seed=2)
    start = cross_matrix(np.array([-0.28, 0.1, 0.03])) @ POSE.R
    E = refine_essential(start, noisy.left_px, noisy.right_px, K_LEFT, K_RIGHT)
    np.testing.assert_allclose(np.linalg.svd(E, compute_uv=False), [1, 1, 0], atol=1e-12)

    def cost(matrix: F64) -> float:
        F = fundamental_from_essential(matrix, K_LEFT, K_RIGHT)
        return float((sampson_distance(F, noisy.left_px, noisy.right_px) ** 2).sum())

    lowest, random = cost(E), np.random.default_rng(0)
    assert lowest < cost(POSE.essential) < cost(start)
    for _ in range(50):
        assert cost(equal_singular_values(E + 1e-4 * random.standard_normal((3, 3)))) > lowest


@pytest.mark.parametrize("method", ["magsac", "ransac"])
def test_wrong_matches_do_no_harm(method: str) -> None:
    seen = views(200, noise_px=0.4, seed=6)
    right = seen.right_px.copy()
    right[:70] = np.random.default_rng(9).uniform((0, 0), SIZE, (70, 2))
    found = estimate_essential(seen.left_px, right, K_LEFT, K_RIGHT, 1.5, method)
    assert found.inliers[70:].all()
    assert found.inliers[:70].sum() < 5
    assert np.degrees(found.pose.rotation_angle_to(POSE)) < 0.2
    assert np.degrees(found.pose.direction_angle_to(POSE)) < 2
    np.testing.assert_allclose(unit_scale(found.pose.essential), unit_scale(found.E), atol=1e-9)


def test_errors_fall_as_the_root_of_the_number() -> None:
    """Four times the matches halve both errors; over 12 draws the ratio is known to about 20 %."""
    for few, many in zip(_mean_errors(100), _mean_errors(400), strict=True):
        assert few / many == pytest.approx(2, rel=0.4)


def _mean_errors(count: int) -> tuple[float, float]:
    """Root mean squares over draws, of the rotation and of the direction of t, radians."""
    squares = []
    for seed in range(12):
        noisy = views(count, noise_px=0.4, seed=seed)
        pose = estimate_essential(noisy.left_px, noisy.right_px, K_LEFT, K_RIGHT, 3.0).pose
        squares.append((pose.rotation_angle_to(POSE) ** 2, pose.direction_angle_to(POSE) ** 2))
    rotation, direction = np.sqrt(np.mean(squares, axis=0))
    return float(rotation), float(direction)


def test_intrinsics_of_other_cameras() -> None:
    seen = views(200, noise_px=0.2)
    elsewhere = K_LEFT + np.array([[0.0, 0, 600], [0, 0, -500], [0, 0, 0]])
    with pytest.raises(
        CalibrationError,
        match=r"\d+ of the \d+ matches .* at least half .* check that these are the intrinsics of the images",
    ):
        estimate_essential(seen.left_px, seen.right_px, elsewhere, K_RIGHT)


@pytest.mark.real_data
def test_pose_of_euroc_from_matches(stereo_data: Path) -> None:
    """Each pair alone gives R within 0.5 and the direction of t within 3 degrees of the published calibration."""
    dataset = EurocDataset(stereo_data / "euroc" / "V1_01_micro")
    left, right = dataset.rig.left, dataset.rig.right
    published = RelativePose.from_rig(dataset.rig)
    for pair in list(dataset)[::8]:
        matches = match_features(pair.left.pixels, pair.right.pixels).undistorted(left, right)
        pose = estimate_essential(matches.left_px, matches.right_px, left.K, right.K).pose
        assert np.degrees(pose.rotation_angle_to(published)) <= 0.5
        assert np.degrees(pose.direction_angle_to(published)) <= 3

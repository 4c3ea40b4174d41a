# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Epipolar geometry of known cameras: against projections, OpenCV and shifted points."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from two_views import F_TRUE, K_LEFT, K_RIGHT, POSE, project, views

from stereo_depth_ros.core.types import F64
from stereo_depth_ros.geometry.epipolar import (
    camera_coordinates,
    epipolar_lines,
    epipoles,
    fundamental_from_essential,
    homogeneous,
    sampson_distance,
    symmetric_epipolar_distance,
)

SEEN = views(60)


def test_fundamental_matrix_of_known_cameras() -> None:
    products = homogeneous(SEEN.right_px) @ F_TRUE * homogeneous(SEEN.left_px)
    scale = np.linalg.norm(F_TRUE) * np.linalg.norm(SEEN.left_px, axis=1) * np.linalg.norm(SEEN.right_px, axis=1)
    assert np.abs(products.sum(axis=1) / scale).max() < 1e-12
    assert abs(np.linalg.det(F_TRUE / np.linalg.norm(F_TRUE))) < 1e-15


def test_essential_matrix_holds_in_camera_coordinates() -> None:
    left, right = camera_coordinates(SEEN.left_px, K_LEFT), camera_coordinates(SEEN.right_px, K_RIGHT)
    np.testing.assert_allclose(left, SEEN.points_m[:, :2] / SEEN.points_m[:, 2:], atol=1e-13)
    assert np.abs(np.einsum("ij,jk,ik->i", homogeneous(right), POSE.essential, homogeneous(left))).max() < 1e-14
    np.testing.assert_array_equal(
        fundamental_from_essential(POSE.essential, np.identity(3), np.identity(3)), POSE.essential
    )


def test_epipoles_are_the_projections_of_the_other_center() -> None:
    left, right = epipoles(F_TRUE)
    np.testing.assert_allclose(left[:2] / left[2], project(POSE.right_center[None], K_LEFT)[0], rtol=1e-8)
    np.testing.assert_allclose(right[:2] / right[2], project(POSE.t[None], K_RIGHT)[0], rtol=1e-8)
    assert np.linalg.norm(left) == pytest.approx(1)
    scale = np.linalg.norm(F_TRUE)
    assert np.abs(F_TRUE @ left).max() < 1e-14 * scale
    assert np.abs(F_TRUE.T @ right).max() < 1e-14 * scale


def test_epipoles_in_camera_coordinates() -> None:
    left, right = epipoles(POSE.essential)
    assert np.linalg.norm(np.cross(left, POSE.right_center)) < 1e-14
    assert np.linalg.norm(np.cross(right, POSE.t)) < 1e-14


def test_epipoles_of_a_rectified_pair_are_at_infinity() -> None:
    left, right = epipoles(np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
    for epipole in (left, right):
        np.testing.assert_allclose(np.abs(epipole), [1, 0, 0], atol=1e-15)


def test_epipolar_lines_contain_the_other_point() -> None:
    lines = epipolar_lines(F_TRUE, SEEN.left_px)
    np.testing.assert_allclose(np.hypot(lines[:, 0], lines[:, 1]), 1, atol=1e-14)
    assert np.abs((lines * homogeneous(SEEN.right_px)).sum(axis=1)).max() < 1e-9
    back = epipolar_lines(F_TRUE.T, SEEN.right_px)
    assert np.abs((back * homogeneous(SEEN.left_px)).sum(axis=1)).max() < 1e-9


def test_epipolar_lines_against_opencv() -> None:
    ours = epipolar_lines(F_TRUE, SEEN.left_px)
    theirs = cv2.computeCorrespondEpilines(SEEN.left_px[:, None], 1, F_TRUE)[:, 0]
    np.testing.assert_allclose(ours * np.sign(ours[:, :1]), theirs * np.sign(theirs[:, :1]), atol=1e-4)


def test_the_epipole_has_no_line() -> None:
    left, _ = epipoles(F_TRUE)
    lines = epipolar_lines(F_TRUE, np.vstack((left[:2] / left[2], SEEN.left_px[0])))
    assert np.isnan(lines[0]).all()
    assert np.isfinite(lines[1]).all()


def test_symmetric_distance_of_a_shift_across_the_rows() -> None:
    """In a rectified pair with the right rows 3 px lower both distances are 3."""
    F = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    lower = SEEN.left_px + np.array([-9.0, 3.0])
    np.testing.assert_allclose(symmetric_epipolar_distance(F, SEEN.left_px, lower), 3, atol=1e-10)


def test_symmetric_distance_is_the_mean_of_both() -> None:
    across = epipolar_lines(F_TRUE, SEEN.left_px)[:, :2]
    moved = SEEN.right_px + 0.7 * across
    in_left = np.abs((epipolar_lines(F_TRUE.T, moved) * homogeneous(SEEN.left_px)).sum(axis=1))
    expected = (0.7 + in_left) / 2
    np.testing.assert_allclose(symmetric_epipolar_distance(F_TRUE, SEEN.left_px, moved), expected, atol=1e-9)
    assert np.ptp(in_left) > 0.01  # the cameras differ, so that the mean differs from both


def test_sampson_distance_is_the_distance_to_the_nearest_exact_match() -> None:
    noisy = views(40, noise_px=0.3, seed=3)
    nearest_left, nearest_right = _corrected(noisy.left_px, noisy.right_px)
    way = np.hypot(
        np.linalg.norm(nearest_left - noisy.left_px, axis=1), np.linalg.norm(nearest_right - noisy.right_px, axis=1)
    )
    np.testing.assert_allclose(sampson_distance(F_TRUE, noisy.left_px, noisy.right_px), way, rtol=2e-3, atol=1e-6)


def _corrected(left_px: F64, right_px: F64) -> tuple[F64, F64]:
    """OpenCV's exact minimum (Hartley and Sturm 1997)."""
    left, right = cv2.correctMatches(F_TRUE, left_px[None], right_px[None])
    return left[0], right[0]


def test_sampson_distance_of_two_epipoles_is_0() -> None:
    """For a camera that moved straight ahead the epipoles are at 0."""
    F = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(sampson_distance(F, np.zeros((1, 2)), np.zeros((1, 2))), 0)

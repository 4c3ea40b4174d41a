# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pixels without distortion and rectified pixels, against the projections that they invert."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from rendered_boards import RIGS, chessboard_points, poses
from rendered_boards import SIZE as BOARD_SIZE
from two_views import K_LEFT, SIZE

from stereo_depth_ros.calibration.projection import MODELS, project
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.geometry.rays import rectify_points, undistort_points

BOARD_M = chessboard_points(6, 4)
COEFFICIENTS = {
    "plumb_bob": [-0.28, 0.07, 0.0006, -0.0009, 0.01],
    "rational_polynomial": [0.4, 0.1, 0.0006, -0.0009, 0.01, 0.7, 0.15, 0.02],
    "equidistant": [-0.03, 0.01, -0.006, 0.001],
}


def camera(model: str, D: list[float]) -> CameraModel:
    return CameraModel(*SIZE, model, K_LEFT, np.array(D), np.identity(3), np.identity(4)[:3])


@pytest.mark.parametrize("model", COEFFICIENTS)
def test_undistorted_points_are_those_of_the_pinhole(model: str) -> None:
    """Rays are projected with and without distortion; the one is turned into the other."""
    side = camera(model, COEFFICIENTS[model])
    rays = np.random.default_rng(1).uniform((-0.75, -0.5), (0.7, 0.5), (200, 2))
    points = np.column_stack((rays, np.ones(200)))
    none = np.zeros(3)
    if model == "equidistant":
        raw = cv2.fisheye.projectPoints(points[:, None], none, none, side.K, side.D)[0][:, 0]
    else:
        raw = cv2.projectPoints(points, none, none, side.K, side.D)[0][:, 0]
    expected = rays * [side.K[0, 0], side.K[1, 1]] + side.K[:2, 2]
    np.testing.assert_allclose(undistort_points(raw, side), expected, atol=1e-6)
    assert np.abs(raw - expected).max() > 5


def test_without_distortion_points_stay() -> None:
    points = np.array([[3.25, 200.5], [700.0, 1.0]])
    np.testing.assert_array_equal(undistort_points(points, camera("plumb_bob", [0.0] * 5)), points)


def test_a_fisheye_whose_coefficients_are_zero_is_not_a_pinhole() -> None:
    """The radius in the image is f theta; without distortion it is f tan(theta)."""
    side, theta = camera("equidistant", [0.0] * 4), np.radians(50)
    raw = np.array([[side.K[0, 2] + side.K[0, 0] * theta, side.K[1, 2]]])
    expected = [[side.K[0, 2] + side.K[0, 0] * np.tan(theta), side.K[1, 2]]]
    np.testing.assert_allclose(undistort_points(raw, side), expected, atol=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_rectified_points_are_those_of_a_pinhole(model: str) -> None:
    rig = RIGS[model]
    pose = poses(1, BOARD_M, rig, seed=5)[0]
    raw = project(model, rig.left, pose, BOARD_M).image_px
    P = np.array([[310.0, 0, 201, -30], [0, 305, 149, 0], [0, 0, 1, 0]])
    K = np.array([[rig.left[0], 0, rig.left[2]], [0, rig.left[1], rig.left[3]], [0, 0, 1]])
    R = cv2.Rodrigues(np.array([0.1, -0.2, 0.05]))[0]
    found = rectify_points(raw, CameraModel(*BOARD_SIZE, model, K, rig.left[4:], R, P))
    rotation = cv2.Rodrigues(R @ cv2.Rodrigues(pose[:3])[0])[0].ravel()
    turned = np.concatenate((rotation, R @ pose[3:]))
    expected = project("plumb_bob", np.array([310.0, 305, 201, 149, *[0.0] * 5]), turned, BOARD_M).image_px
    np.testing.assert_allclose(found, expected, atol=1e-5)

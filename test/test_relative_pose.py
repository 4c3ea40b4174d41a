# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pose of the right camera: against points moved by it, and a rig made with known R and T."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from two_views import K_LEFT, K_RIGHT, POSE, SIZE

from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.geometry.relative_pose import RelativePose, cross_matrix


def test_cross_matrix() -> None:
    v, w = np.array([0.3, -1.2, 2.0]), np.array([-0.7, 0.4, 1.1])
    np.testing.assert_allclose(cross_matrix(v) @ w, np.cross(v, w), atol=1e-15)


def test_right_center_is_the_origin_of_the_right_camera() -> None:
    np.testing.assert_allclose(POSE.R @ POSE.right_center + POSE.t, 0, atol=1e-15)


def test_essential_matrix_of_one_point_in_both_cameras() -> None:
    point = np.array([0.8, -0.5, 3.1])
    assert abs((POSE.R @ point + POSE.t) @ POSE.essential @ point) < 1e-14
    # Of the length of the baseline, twice, and with rank 2
    singular = np.linalg.svd(POSE.essential, compute_uv=False)
    np.testing.assert_allclose(singular, np.linalg.norm(POSE.t) * np.array([1, 1, 0]), atol=1e-14)


def test_essential_matrix_is_the_textbook_s() -> None:
    """R [T]x and [t]x R are equal up to sign."""
    np.testing.assert_allclose(POSE.essential, -cross_matrix(POSE.t) @ POSE.R, atol=1e-15)


def test_pose_of_a_rig() -> None:
    D = [-0.2, 0.05, 0.001, -0.0007, 0.01]
    rig = StereoRig.from_calibration(K_LEFT, D, K_RIGHT, D, POSE.R, POSE.t, SIZE)
    pose = RelativePose.from_rig(rig)
    np.testing.assert_allclose(pose.R, POSE.R, atol=1e-9)
    np.testing.assert_allclose(pose.t, POSE.t, atol=1e-9)


def test_up_to_scale_keeps_the_direction() -> None:
    pose = RelativePose(POSE.R, 7 * POSE.t, up_to_scale=True)
    assert np.linalg.norm(pose.t) == pytest.approx(1, abs=1e-15)
    assert pose.direction_angle_to(POSE) < 1e-8


@pytest.mark.parametrize("degrees", [1e-5, 0.4, 90.0, 179.99])
def test_angles(degrees: float) -> None:
    axis = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    turn = cv2.Rodrigues(axis * np.radians(degrees))[0]
    turned = RelativePose(turn @ POSE.R, POSE.t)
    assert np.degrees(POSE.rotation_angle_to(turned)) == pytest.approx(degrees, rel=1e-6)
    across = np.cross(axis, POSE.t)
    moved = RelativePose(POSE.R, cv2.Rodrigues(across / np.linalg.norm(across) * np.radians(degrees))[0] @ POSE.t)
    assert np.degrees(POSE.direction_angle_to(moved)) == pytest.approx(degrees, rel=1e-6)


def test_the_other_direction_is_180_degrees_away() -> None:
    assert POSE.direction_angle_to(RelativePose(POSE.R, -POSE.t)) == pytest.approx(np.pi)


def test_invalid_poses() -> None:
    with pytest.raises(CalibrationError, match=r"shape \(2, 2\) and t \(3,\).*\(3, 3\)"):
        RelativePose(np.identity(2), POSE.t)
    with pytest.raises(CalibrationError, match="R from the left to the right camera"):
        RelativePose(1.1 * POSE.R, POSE.t)
    for nothing in ([0.0, 0.0, 0.0], [0.1, np.nan, 0.0]):
        with pytest.raises(CalibrationError, match="is not a baseline"):
            RelativePose(POSE.R, np.array(nothing))

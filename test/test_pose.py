# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses: products, inverses, quaternions, and interpolation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.types import F64

POINTS = np.array([[0.3, -1.2, 2.0], [5.0, 0.7, -0.4]])


def turned(vector: list[float], translation: list[float]) -> Pose:
    return Pose(np.asarray(cv2.Rodrigues(np.array(vector))[0], np.float64), np.array(translation))


def test_products_and_inverses() -> None:
    one, other = turned([0.3, -0.5, 0.9], [1.0, 2.0, -3.0]), turned([-1.1, 0.2, 0.4], [0.1, -0.7, 0.5])
    by_matrix = (one.matrix @ other.matrix @ np.c_[POINTS, np.ones(2)].T).T[:, :3]
    np.testing.assert_allclose((one @ other).apply(POINTS), by_matrix, atol=1e-12)
    np.testing.assert_allclose(one.inverse().apply(one.apply(POINTS)), POINTS, atol=1e-12)
    np.testing.assert_allclose(Pose.from_matrix(one.matrix[:3]).matrix, one.matrix)


@pytest.mark.parametrize("angle", [1e-9, 0.4, 2.0, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.36, -0.48, 0.8), (-0.6, 0.64, 0.48)])
def test_quaternions(angle: float, axis: tuple[float, ...]) -> None:
    quaternion = np.array([*(np.sin(angle / 2) * np.array(axis)), np.cos(angle / 2)])
    pose = Pose.from_quaternion(3.0 * quaternion, np.zeros(3))  # of any length
    expected: F64 = cv2.Rodrigues(angle * np.array(axis))[0]
    np.testing.assert_allclose(pose.rotation, expected, atol=1e-12)
    found = pose.quaternion
    np.testing.assert_allclose(found if found @ quaternion > 0 else -found, quaternion, atol=1e-8)


def test_interpolation_turns_at_a_constant_rate_along_the_shortest_way() -> None:
    one, other = turned([0, 0, -0.4], [0.0, 1.0, 4.0]), turned([0, 0, 0.8], [2.0, 1.0, 0.0])
    between = one.interpolate(other, 0.25)
    np.testing.assert_allclose(between.rotation, turned([0, 0, -0.1], [0, 0, 0]).rotation, atol=1e-12)
    np.testing.assert_allclose(between.translation_m, [0.5, 1.0, 3.0])
    far = turned([0, 0, -3.0], [0, 0, 0]).interpolate(turned([0, 0, 3.0], [0, 0, 0]), 0.5)  # across half a turn
    np.testing.assert_allclose(far.rotation, turned([0, 0, np.pi], [0, 0, 0]).rotation, atol=1e-12)

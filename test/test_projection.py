# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Projection by lens models: Jacobians, and the distortion range."""

from __future__ import annotations

import numpy as np
import pytest
from rendered_boards import RIGS, SIZE, chessboard_points, poses

from stereo_depth_ros.calibration.projection import (
    MODELS,
    check_model,
    distortion_range_px,
    parameter_names,
    project,
)
from stereo_depth_ros.core.errors import ConfigError

BOARD_M = chessboard_points(6, 4)


@pytest.mark.parametrize("model", MODELS)
def test_derivatives_are_those_of_the_projection(model: str) -> None:
    rig = RIGS[model]
    pose = poses(1, BOARD_M, rig, seed=3)[0]
    at = project(model, rig.left, pose, BOARD_M)
    for number in range(rig.left.size):
        step = np.zeros(rig.left.size)
        step[number] = 1e-4 * max(abs(rig.left[number]), 0.1)
        ahead, behind = (project(model, rig.left + sign * step, pose, BOARD_M).image_px for sign in (1, -1))
        numeric = ((ahead - behind) / (2 * step[number])).ravel()
        np.testing.assert_allclose(at.jacobian_intrinsics[:, number], numeric, rtol=1e-4, atol=1e-4)
    for number in range(6):
        step = np.zeros(6)
        step[number] = 1e-6
        ahead, behind = (project(model, rig.left, pose + sign * step, BOARD_M).image_px for sign in (1, -1))
        numeric = ((ahead - behind) / 2e-6).ravel()
        np.testing.assert_allclose(at.jacobian_pose[:, number], numeric, rtol=1e-4, atol=1e-3)


def test_names() -> None:
    assert parameter_names("equidistant") == ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    with pytest.raises(ConfigError, match="'fisheye' is not one of plumb_bob, rational_polynomial, equidistant"):
        check_model("fisheye")


def test_distortion_range() -> None:
    """r (1 + k r^2) has its maximum at r = 1 / sqrt(-3 k), where the radius is 2/3 of that."""
    intrinsics = np.array([300.0, 300, 199.5, 149.5, -0.8, 0, 0, 0, 0])
    turn_px, corner_px = distortion_range_px("plumb_bob", intrinsics, SIZE)
    assert turn_px == pytest.approx(300 * 2 / 3 / np.sqrt(2.4), rel=1e-3)
    assert corner_px == pytest.approx(np.hypot(199.5, 149.5))
    assert distortion_range_px("plumb_bob", RIGS["plumb_bob"].left, SIZE)[0] == float("inf")
    assert distortion_range_px("equidistant", RIGS["equidistant"].left, SIZE)[0] == float("inf")

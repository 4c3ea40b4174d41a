# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Triangulation against the closed form and against OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import Reason
from stereo_depth_ros.stages.depth import depth_from_disparity, depth_sigma, millimeters, reject_behind

WIDTH, HEIGHT = 37, 23


@pytest.fixture
def rig() -> StereoRig:
    return StereoRig.from_rectified(
        fx=410.0, fy=395.0, cx_left=17.5, cx_right=12.25, cy=9.0, baseline_m=0.12, size=(WIDTH, HEIGHT), frame_id="left"
    )


def test_depth_is_f_times_baseline_over_disparity_less_offset(rig: StereoRig) -> None:
    disparity_px = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    disparity_px[3, 5] = 5.25 + 8.0  # the offset is 17.5 - 12.25
    disparity_px[20, 36] = 5.25 + 0.5
    disparity_px[1, 2] = 5.25  # at infinity
    disparity_px[1, 3] = 2.0  # behind
    depth_m = depth_from_disparity(disparity_px, Triangulation.from_rig(rig))
    assert depth_m[3, 5] == pytest.approx(410 * 0.12 / 8.0, rel=1e-6)
    assert depth_m[20, 36] == pytest.approx(410 * 0.12 / 0.5, rel=1e-6)
    assert np.isfinite(depth_m).sum() == 2


def test_depth_agrees_with_opencv_reprojection(rig: StereoRig) -> None:
    disparity_px = np.linspace(6, 60, HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    expected = cv2.reprojectImageTo3D(disparity_px, rig.Q)[:, :, 2]
    depth_m = depth_from_disparity(disparity_px, Triangulation.from_rig(rig))
    np.testing.assert_allclose(depth_m, expected, rtol=2e-6)  # float32 rounding of d - doffs


def test_depth_writes_into_the_given_array(rig: StereoRig) -> None:
    out = np.zeros((HEIGHT, WIDTH), np.float32)
    disparity_px = np.full((HEIGHT, WIDTH), 20.0, np.float32)
    assert depth_from_disparity(disparity_px, Triangulation.from_rig(rig), out) is out
    assert (out > 0).all()


def test_sigma_is_the_derivative_of_depth(rig: StereoRig) -> None:
    disparity_px = np.array([[8.0, 20.0, np.nan]], np.float32)
    triangulation = Triangulation.from_rig(rig)
    depth_m = depth_from_disparity(disparity_px, triangulation)
    step = 0.01
    moved = depth_from_disparity(disparity_px - np.float32(step), triangulation)
    sigma_m = depth_sigma(depth_m, triangulation, step)
    np.testing.assert_allclose(sigma_m[0, :2], (moved - depth_m)[0, :2], rtol=0.01)  # second order: step / d
    assert np.isnan(sigma_m[0, 2])


def test_millimeters_are_rounded_and_zero_where_invalid() -> None:
    depth_m = np.array([[1.2344, 1.2346, np.nan, 65.535, 65.536, np.inf]], np.float32)
    assert millimeters(depth_m).tolist() == [[1234, 1235, 0, 65535, 0, 0]]


def test_points_behind_the_cameras_are_rejected_with_a_reason() -> None:
    disparity_px = np.array([[-1.0, 3.0, 3.0625, np.nan]], np.float32)
    reasons = np.array([[0, 0, 0, Reason.TEXTURE]], np.uint8)
    reject_behind(disparity_px, reasons, 3.0)
    assert np.isnan(disparity_px).tolist() == [[True, True, False, True]]
    assert reasons.tolist() == [[Reason.RANGE, Reason.RANGE, 0, Reason.TEXTURE]]

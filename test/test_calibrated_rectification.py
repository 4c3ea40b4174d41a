# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectification of calibrated cameras: rows of known points, field of view, OpenCV, real pairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, U8, StereoPair
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.geometry.calibrated_rectification import (
    METHODS,
    Area,
    common_area,
    rectify_calibrated,
    rectifying_rotations,
)
from stereo_depth_ros.geometry.correspondences import match_features
from stereo_depth_ros.geometry.rays import camera_rays
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.stages.rectification import Rectifier

SIZE = (620, 460)
POSE = RelativePose(cv2.Rodrigues(np.array([0.03, -0.08, 0.05]))[0], np.array([-0.31, 0.04, 0.03]))
_LENSES = {
    "plumb_bob": (455.0, [-0.2, 0.05, 0.001, -0.0007, 0.01], [-0.17, 0.03, -0.0004, 0.0009, 0.02]),
    "equidistant": (230.0, [-0.03, 0.01, -0.006, 0.001], [-0.02, 0.005, -0.004, 0.001]),
}


def cameras(model: str) -> tuple[CameraModel, CameraModel]:
    f, *D = _LENSES[model]
    K = (
        np.array([[f, 0, 301], [0, 1.02 * f, 238], [0, 0, 1]]),
        np.array([[1.04 * f, 0, 322], [0, 1.03 * f, 219], [0, 0, 1]]),
    )
    left, right = (
        CameraModel(*SIZE, model, k, np.array(d), np.identity(3), np.identity(4)[:3]) for k, d in zip(K, D, strict=True)
    )
    return left, right


def seen(points_m: F64, rig: StereoRig) -> tuple[F64, F64]:
    """Points of the raw left camera in both rectified images, px; of the right one by its own pose and P."""
    left = (points_m @ rig.left.R.T) @ rig.left.P[:, :3].T
    right_m = (points_m @ POSE.R.T + POSE.t) @ rig.right.R.T
    right = right_m @ rig.right.P[:, :3].T
    return left[:, :2] / left[:, 2:], right[:, :2] / right[:, 2:]


@pytest.mark.parametrize("model", _LENSES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("alpha", [0.0, 0.6])
def test_rows_agree_and_disparities_give_the_depth(model: str, method: str, alpha: float) -> None:
    rig = rectify_calibrated(*cameras(model), POSE, method=method, alpha=alpha)
    points = np.random.default_rng(1).uniform((-2, -1.5, 2), (2, 1.5, 9), (50, 3))
    left, right = seen(points, rig)
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    depth = rig.f_px * rig.baseline_m / (left[:, 0] - right[:, 0] - rig.doffs_px)
    np.testing.assert_allclose(depth, (points @ rig.left.R.T)[:, 2], rtol=1e-9)
    assert rig.baseline_m == pytest.approx(np.linalg.norm(POSE.t))


def test_the_pose_of_the_rig_is_the_one_given() -> None:
    pose = RelativePose.from_rig(rectify_calibrated(*cameras("plumb_bob"), POSE))
    np.testing.assert_allclose(pose.R, POSE.R, atol=1e-12)
    np.testing.assert_allclose(pose.t, POSE.t, atol=1e-12)


def test_rotations_are_the_textbook_s() -> None:
    R_left, R_right = rectifying_rotations(POSE)
    T = POSE.right_center
    np.testing.assert_allclose(R_left @ T / np.linalg.norm(T), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(R_left @ R_left.T, np.identity(3), atol=1e-15)
    np.testing.assert_allclose(R_right, R_left @ POSE.R.T)
    assert abs(R_left[1] @ [0, 0, 1]) < 1e-15  # the new y axis is orthogonal to the old optical axis


def test_it_is_opencv_s_up_to_a_rotation_about_the_baseline() -> None:
    """Such a rotation does not affect row alignment."""
    ours, theirs = (rectify_calibrated(*cameras("plumb_bob"), POSE, method=method) for method in METHODS)
    between = ours.left.R @ theirs.left.R.T
    np.testing.assert_allclose(between[0], [1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(ours.right.R @ theirs.right.R.T, between, atol=1e-9)


@pytest.mark.parametrize("model", _LENSES)
@pytest.mark.parametrize("zero_disparity", [True, False])
def test_alpha_0_shows_valid_pixels_only(model: str, zero_disparity: bool) -> None:
    rig = rectify_calibrated(*cameras(model), POSE, zero_disparity=zero_disparity)
    rectifier = Rectifier(rig)
    assert rectifier.left_source.all()
    assert rectifier.right_source.all()
    assert common_area(rig) == Area(0, 0, *SIZE)
    if model == "plumb_bob":  # the field of view is maximal: one direction reaches the border
        larger = Rectifier(replace_focal(rig, 0.98))
        assert not (larger.left_source.all() and larger.right_source.all())


def replace_focal(rig: StereoRig, factor: float) -> StereoRig:
    """The rig with a slightly larger field of view."""
    factors = np.array([[factor, 1, 1, factor], [1, factor, 1, 1], [1, 1, 1, 1]])
    left, right = (replace(side, P=side.P * factors) for side in (rig.left, rig.right))
    return StereoRig(left, right)


@pytest.mark.parametrize("zero_disparity", [True, False])
def test_alpha_1_shows_all_raw_pixels(zero_disparity: bool) -> None:
    rig = rectify_calibrated(*cameras("plumb_bob"), POSE, alpha=1, zero_disparity=zero_disparity)
    touched = []
    for side in (rig.left, rig.right):
        x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, SIZE[0] - 1, 40), np.linspace(0, SIZE[1] - 1, 30)))
        rays = camera_rays(np.column_stack((x, y)), side) @ side.R.T @ side.P[:, :3].T
        pixels = rays[:, :2] / rays[:, 2:]
        assert (pixels > -0.5).all()
        assert (pixels < np.array(SIZE) - 0.5).all()
        touched += [
            pixels[:, 0].min(),
            pixels[:, 1].min(),
            SIZE[0] - 1 - pixels[:, 0].max(),
            SIZE[1] - 1 - pixels[:, 1].max(),
        ]
    assert min(touched) < 1  # no larger than needed
    assert not Rectifier(rig).left_source.all()


def test_alpha_is_between() -> None:
    focal = [rectify_calibrated(*cameras("plumb_bob"), POSE, alpha=alpha).f_px for alpha in (0, 0.3, 1)]
    assert focal[0] > focal[1] > focal[2]
    assert focal[1] == pytest.approx(0.7 * focal[0] + 0.3 * focal[2])


def test_field_of_view_of_a_fisheye_is_limited() -> None:
    """With alpha 1 the edges are at half of the limit."""
    sides = cameras("equidistant")
    narrow, wide = (rectify_calibrated(*sides, POSE, alpha=1, max_fov_deg=degrees) for degrees in (90, 140))
    assert narrow.f_px > 1.5 * wide.f_px
    corner_deg = np.degrees(np.arctan(np.hypot(narrow.width / 2, narrow.height / 2) / narrow.f_px))
    assert corner_deg >= 45


def test_without_zero_disparity_converging_cameras_have_more_in_common() -> None:
    """Cameras rotated towards each other by 14 degrees."""
    pose = RelativePose(cv2.Rodrigues(np.array([0.0, 0.25, 0.0]))[0], POSE.t)
    same, own = (rectify_calibrated(*cameras("plumb_bob"), pose, zero_disparity=zero) for zero in (True, False))
    assert same.doffs_px == 0
    assert abs(own.doffs_px) > 50
    assert own.f_px < 0.9 * same.f_px
    assert Rectifier(own).left_source.all()


def test_common_area_is_valid_in_both() -> None:
    rig = rectify_calibrated(*cameras("plumb_bob"), POSE, alpha=0.8)
    area = common_area(rig)
    both = Rectifier(rig).left_source & Rectifier(rig).right_source
    assert both[area.y : area.y + area.height, area.x : area.x + area.width].all()
    assert area.width * area.height > 0.7 * both.sum()
    assert not both.all()


def test_rays_project_to_their_pixels() -> None:
    for side in (*cameras("plumb_bob"), *cameras("equidistant")):
        pixels = np.random.default_rng(0).uniform((0, 0), SIZE, (50, 2))
        rays = camera_rays(pixels, side)
        np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1)
        front = rays[:, 2] > 0.1
        project = cv2.fisheye.projectPoints if side.distortion_model == "equidistant" else cv2.projectPoints
        back = project(rays[front][:, None], np.zeros(3), np.zeros(3), side.K, side.D)[0].reshape(-1, 2)
        np.testing.assert_allclose(back, pixels[front], atol=1e-3)
        assert front.sum() > 40


@pytest.mark.parametrize(
    ("t", "text"),
    [
        ([0.3, 0.02, 0.0], "left and right are swapped"),
        ([-0.1, 0.02, 0.4], "an epipole is in or near an image"),
        ([-0.1, 0.4, 0.02], "above or below: rotate the images by 90 degrees"),
    ],
)
def test_baselines_that_no_rotation_makes_horizontal(t: list[float], text: str) -> None:
    for method in METHODS:
        with pytest.raises(CalibrationError, match=rf"limit 45.*{text}"):
            rectify_calibrated(*cameras("plumb_bob"), RelativePose(np.identity(3), np.array(t)), method=method)


def test_invalid_arguments() -> None:
    sides = cameras("plumb_bob")
    with pytest.raises(ConfigError, match="'bouguet' is not one of textbook, opencv"):
        rectify_calibrated(*sides, POSE, method="bouguet")
    with pytest.raises(ConfigError, match=r"alpha = 1\.5 is outside 0\.\.1"):
        rectify_calibrated(*sides, POSE, alpha=1.5)
    with pytest.raises(ConfigError, match=r"max_fov_deg = 180 is outside 10\.\.170"):
        rectify_calibrated(*sides, POSE, max_fov_deg=180)
    with pytest.raises(CalibrationError, match="known up to scale, P needs meters"):
        rectify_calibrated(*sides, RelativePose(POSE.R, POSE.t, up_to_scale=True))
    with pytest.raises(CalibrationError, match=r"baseline 310\.\d+ m is outside"):
        rectify_calibrated(*sides, RelativePose(POSE.R, 990 * POSE.t))
    aside = RelativePose(
        cv2.Rodrigues(np.array([0, 1.3, 0.0]))[0], cv2.Rodrigues(np.array([0, 1.3, 0.0]))[0] @ [-0.3, 0, 0]
    )
    with pytest.raises(CalibrationError, match="no field of view in common: check R of the pose"):
        rectify_calibrated(*sides, aside)


@pytest.fixture(scope="module")
def euroc(stereo_data: Path) -> EurocDataset:
    return EurocDataset(stereo_data / "euroc" / "V1_01_micro")


@pytest.fixture(scope="module")
def raw_rows_px(euroc: EurocDataset) -> float:
    """Median row error of the raw images."""
    return median_rows_px([(frame.left.pixels, frame.right.pixels) for frame in list(euroc)[::6]])


def median_rows_px(pairs: list[tuple[U8, U8]]) -> float:
    found = [match_features(*pair) for pair in pairs]
    return float(np.median(np.concatenate([np.abs(m.left_px[:, 1] - m.right_px[:, 1]) for m in found])))


@pytest.mark.real_data
@pytest.mark.parametrize("method", METHODS)
def test_rows_of_euroc(euroc: EurocDataset, raw_rows_px: float, method: str) -> None:
    """Median row error of 12.8 px before and at most 0.15 px after, with the published calibration."""
    rig = rectify_calibrated(euroc.rig.left, euroc.rig.right, RelativePose.from_rig(euroc.rig), method=method)
    rectifier = Rectifier(rig)
    rectified = [rectifier.rectify(StereoPair(frame.left, frame.right)) for frame in list(euroc)[::6]]
    assert raw_rows_px == pytest.approx(12.8, abs=1)
    assert median_rows_px([(pair.left, pair.right) for pair in rectified]) <= 0.15

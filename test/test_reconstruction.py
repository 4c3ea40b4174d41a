# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reconstruction at three levels, Euclidean, up to scale and projective, against known points."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from two_views import F_TRUE, K_LEFT, K_RIGHT, POSE, SIZE, Views, views

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError, ImageError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, Reason
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.geometry.correspondences import match_features
from stereo_depth_ros.geometry.eight_point import unit_scale
from stereo_depth_ros.geometry.epipolar import fundamental_from_pose, symmetric_epipolar_distance
from stereo_depth_ros.geometry.reconstruction import Cameras, Level, canonical_cameras, reconstruct
from stereo_depth_ros.geometry.triangulation import fundamental_from_cameras

D_LEFT, D_RIGHT = np.array([-0.2, 0.05, 0.001, -0.0007, 0.01]), np.array([-0.17, 0.03, -0.0004, 0.0009, 0.02])
LEFT = CameraModel(*SIZE, "plumb_bob", K_LEFT, D_LEFT, np.identity(3), np.identity(4)[:3])
RIGHT = CameraModel(*SIZE, "plumb_bob", K_RIGHT, D_RIGHT, np.identity(3), np.identity(4)[:3])
RIG = StereoRig.from_calibration(K_LEFT, D_LEFT, K_RIGHT, D_RIGHT, POSE.R, POSE.t, SIZE)


def distorted(seen: Views) -> tuple[F64, F64]:
    """The same points through the lenses."""
    none = np.zeros(3)
    left = cv2.projectPoints(seen.points_m, none, none, K_LEFT, D_LEFT)[0][:, 0]
    right = cv2.projectPoints(seen.points_m @ POSE.R.T + POSE.t, none, none, K_RIGHT, D_RIGHT)[0][:, 0]
    return left, right


def test_with_intrinsics_and_extrinsics_it_is_euclidean() -> None:
    seen = views(40)
    found = reconstruct(*distorted(seen), RIG)
    assert found.level is Level.EUCLIDEAN
    assert found.level.unit == "meters"
    assert found.valid.all()
    np.testing.assert_allclose(found.points, seen.points_m, rtol=1e-5)
    assert found.residual_px.max() < 1e-4


def test_with_intrinsics_it_is_known_up_to_scale() -> None:
    """One factor, the baseline, maps all points to their true positions."""
    seen = views(60)
    found = reconstruct(*distorted(seen), (LEFT, RIGHT))
    assert found.level is Level.UP_TO_SCALE
    assert found.level.unit == "baselines"
    assert found.pose is not None
    assert np.linalg.norm(found.pose.t) == pytest.approx(1)
    ratios = seen.points_m / found.points
    assert found.valid.all()
    np.testing.assert_allclose(ratios, np.linalg.norm(POSE.t), rtol=1e-3)


def test_a_baseline_makes_it_euclidean() -> None:
    seen = views(60)
    found = reconstruct(*distorted(seen), (LEFT, RIGHT)).with_baseline(float(np.linalg.norm(POSE.t)))
    assert found.level is Level.EUCLIDEAN
    assert found.pose is not None
    np.testing.assert_allclose(found.points, seen.points_m, rtol=1e-3)
    np.testing.assert_allclose(found.pose.t, POSE.t, atol=1e-4)
    X = np.column_stack((found.points, np.ones(60))) @ found.P_right.T
    np.testing.assert_allclose(X[:, :2] / X[:, 2:], seen.right_px, atol=0.05)


def test_without_anything_it_is_projective() -> None:
    """A homography of space, found from some points, maps all others to their true positions."""
    seen = views(60)
    found = reconstruct(seen.left_px, seen.right_px, None)
    assert found.level is Level.PROJECTIVE
    assert found.level.unit is None
    assert found.pose is None
    np.testing.assert_array_equal(found.P_left, np.identity(4)[:3])
    H = space_homography(found.homogeneous[:15], seen.points_m[:15])
    moved = found.homogeneous @ H.T
    np.testing.assert_allclose(moved[15:, :3] / moved[15:, 3:], seen.points_m[15:], rtol=1e-4)
    assert np.linalg.cond(H) > 2  # the frame is another one


def space_homography(X: F64, points_m: F64) -> F64:
    """float64 (4, 4): the least-squares solution of X' x H X = 0."""
    Y = np.column_stack((points_m, np.ones(len(X))))
    rows = []
    for x, y in zip(X, Y, strict=True):
        for i in range(3):
            row = np.zeros((4, 4))
            row[i] = y[3] * x
            row[3] = -y[i] * x
            rows.append(row.ravel())
    H: F64 = np.linalg.svd(np.array(rows))[2][15].reshape(4, 4)
    return H


def test_a_projective_one_has_no_points() -> None:
    seen = views(60)
    found = reconstruct(seen.left_px, seen.right_px, None)
    with pytest.raises(CalibrationError, match=r"no X, Y, Z.*give the intrinsics of the cameras"):
        _ = found.points


def test_a_baseline_applies_to_nothing_else() -> None:
    found = reconstruct(*distorted(views(40)), RIG)
    with pytest.raises(
        CalibrationError, match="euclidean reconstruction: a baseline applies to an up_to_scale reconstruction only"
    ):
        found.with_baseline(0.1)
    scaled = reconstruct(*distorted(views(60)), (LEFT, RIGHT))
    with pytest.raises(CalibrationError, match=r"baseline -1 m is not above 0: measure it"):
        scaled.with_baseline(-1)


@pytest.mark.parametrize("cameras", [RIG, (LEFT, RIGHT), None], ids=["rig", "intrinsics", "nothing"])
def test_wrong_matches_have_no_point(cameras: Cameras) -> None:
    seen = views(80, noise_px=0.1)
    left, right = (seen.left_px, seen.right_px) if cameras is None else distorted(seen)
    right = right.copy()
    right[5] += [0, 25]
    found = reconstruct(left, right, cameras)
    assert found.reasons[5] == Reason.NO_MATCH
    assert np.isnan(found.homogeneous[5]).all()
    assert found.residual_px[5] > 5
    assert found.valid.sum() >= 78
    np.testing.assert_array_equal(found.valid, np.isfinite(found.homogeneous).all(axis=1))


def test_points_behind_the_cameras_have_no_depth() -> None:
    """The match of a point behind both: along the line of sight, on the other side of infinity."""
    point = np.array([[0.4, 0.3, -3.0]])
    left, right = (p[:, :2] / p[:, 2:] for p in (point @ K_LEFT.T, (point @ POSE.R.T + POSE.t) @ K_RIGHT.T))
    rig = StereoRig.from_calibration(K_LEFT, [], K_RIGHT, [], POSE.R, POSE.t, SIZE)
    found = reconstruct(left, right, rig)
    assert found.reasons.tolist() == [Reason.RANGE]
    far = np.array([[3e8, 1e8, 9e8]])
    left, right = (p[:, :2] / p[:, 2:] for p in (far @ K_LEFT.T, (far @ POSE.R.T + POSE.t) @ K_RIGHT.T))
    assert reconstruct(left, right, rig).reasons.tolist() == [Reason.RANGE]


def test_canonical_cameras_have_the_fundamental_matrix() -> None:
    for v, scale in (((0, 0, 0), 1.0), ((0.3, -0.2, 1.1), -2.5)):
        cameras = canonical_cameras(5 * F_TRUE, v, scale)
        np.testing.assert_array_equal(cameras[0], np.identity(4)[:3])
        np.testing.assert_allclose(unit_scale(fundamental_from_cameras(*cameras)), unit_scale(F_TRUE), atol=1e-12)


def test_points_that_are_not_pairs() -> None:
    with pytest.raises(ImageError, match=r"\(4, 2\) and \(3, 2\)"):
        reconstruct(np.zeros((4, 2)), np.zeros((3, 2)), RIG)
    seen = views(7)
    with pytest.raises(CalibrationError, match="7 different matches of 7"):
        reconstruct(seen.left_px, seen.right_px, None)


def test_errors_fall_as_the_root_of_the_number() -> None:
    """Up to scale, the direction of t, and with it the points, are the better known the more matches there are."""

    def error(count: int) -> float:
        squares = []
        for seed in range(24):
            seen = views(count, noise_px=0.3, seed=seed)
            found = reconstruct(seen.left_px, seen.right_px, (bare(K_LEFT), bare(K_RIGHT)), 3.0)
            assert found.pose is not None
            squares.append(found.pose.direction_angle_to(POSE) ** 2)
        return float(np.sqrt(np.mean(squares)))

    assert error(100) / error(400) == pytest.approx(2, rel=0.3)


def bare(K: F64) -> CameraModel:
    return CameraModel(*SIZE, "plumb_bob", K, np.zeros(5), np.identity(3), np.identity(4)[:3])


@pytest.mark.real_data
def test_euroc_at_all_levels(stereo_data: Path) -> None:
    """Depths up to scale are those of the calibration, and the projective cameras have its fundamental matrix."""
    dataset = EurocDataset(stereo_data / "euroc" / "V1_01_micro")
    pair, rig = next(iter(dataset)), dataset.rig
    matches = match_features(pair.left.pixels, pair.right.pixels)
    metric = reconstruct(matches.left_px, matches.right_px, rig)
    scaled = reconstruct(matches.left_px, matches.right_px, (rig.left, rig.right)).with_baseline(rig.baseline_m)
    both = metric.valid & scaled.valid
    assert both.sum() > 300
    assert metric.pose is not None
    near = both & (metric.points[:, 2] < 4)
    assert np.median(np.abs(scaled.points[near, 2] / metric.points[near, 2] - 1)) < 0.05
    straight = matches.undistorted(rig.left, rig.right)
    projective = reconstruct(straight.left_px, straight.right_px, None)
    F = fundamental_from_cameras(projective.P_left, projective.P_right)
    published = fundamental_from_pose(metric.pose, rig.left.K, rig.right.K)
    fit = symmetric_epipolar_distance(published, straight.left_px, straight.right_px) < 1
    assert symmetric_epipolar_distance(F, straight.left_px[fit], straight.right_px[fit]).mean() <= 0.5

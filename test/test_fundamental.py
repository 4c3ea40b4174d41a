# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The fundamental matrix of matches with outliers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from two_views import SIZE, Views, plane_views, views

from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.geometry.correspondences import match_features
from stereo_depth_ros.geometry.epipolar import (
    epipoles,
    fundamental_from_pose,
    sampson_distance,
    symmetric_epipolar_distance,
)
from stereo_depth_ros.geometry.fundamental import estimate_fundamental
from stereo_depth_ros.geometry.relative_pose import RelativePose

METHODS = ["magsac", "ransac"]
CLEAN = views(300, seed=99)


def with_wrong(seen: Views, share: float, seed: int = 0) -> tuple[Views, int]:
    """The same with random right points for the first matches; and their number."""
    wrong = int(share * len(seen.left_px))
    right = seen.right_px.copy()
    right[:wrong] = np.random.default_rng(seed + 1000).uniform((0, 0), SIZE, (wrong, 2))
    return Views(seen.points_m, seen.left_px, right), wrong


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_outliers_do_no_harm(method: str, share: float) -> None:
    seen, wrong = with_wrong(views(300, noise_px=0.4, seed=7), share)
    found = estimate_fundamental(seen.left_px, seen.right_px, 1.5, method)
    assert found.inliers[wrong:].mean() > 0.99
    assert found.inliers[:wrong].mean() < 0.05 if wrong else True
    assert sampson_distance(found.F, CLEAN.left_px, CLEAN.right_px).mean() < 0.2
    # Seven parameters use seven degrees of freedom; residuals across the lines have 0.4 px in each of the others
    assert found.sampson_rms_px == pytest.approx(0.4, rel=0.15)


@pytest.mark.parametrize("method", METHODS)
def test_properties(method: str) -> None:
    seen, _ = with_wrong(views(150, noise_px=0.5, seed=3), 0.2)
    F = estimate_fundamental(seen.left_px, seen.right_px, 1.5, method).F
    left, right = epipoles(F)
    assert np.linalg.norm(F) == pytest.approx(1)
    assert F.ravel()[np.abs(F).argmax()] > 0
    assert abs(np.linalg.det(F)) < 1e-18
    assert np.abs(F @ left).max() < 1e-12
    assert np.abs(right @ F).max() < 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_inliers_and_rms_are_those_of_the_matrix(method: str) -> None:
    seen, _ = with_wrong(views(120, noise_px=0.5, seed=8), 0.3)
    found = estimate_fundamental(seen.left_px, seen.right_px, 1.2, method)
    distances = sampson_distance(found.F, seen.left_px, seen.right_px)
    np.testing.assert_array_equal(found.inliers, distances < 1.2)
    assert found.sampson_rms_px == pytest.approx(np.sqrt(np.mean(distances[found.inliers] ** 2)))


@pytest.mark.parametrize("method", METHODS)
def test_deterministic(method: str) -> None:
    seen, _ = with_wrong(views(120, noise_px=0.5, seed=8), 0.4)
    first, second = (estimate_fundamental(seen.left_px, seen.right_px, 1.0, method) for _ in range(2))
    np.testing.assert_array_equal(first.F, second.F)


@pytest.mark.parametrize("method", METHODS)
def test_errors_fall_as_the_root_of_the_number(method: str) -> None:
    """Four times the matches, a quarter of them wrong, halve the error; the ratio of medians is known to about 20 %."""
    few, many = (_median_error(count, method) for count in (100, 400))
    assert few / many == pytest.approx(2, rel=0.4)


def _median_error(count: int, method: str) -> float:
    """Medians over draws, as an outlier that fits by chance affects a single draw strongly."""
    errors = []
    for seed in range(16):
        seen, _ = with_wrong(views(count, noise_px=0.4, seed=seed), 0.25, seed)
        F = estimate_fundamental(seen.left_px, seen.right_px, 1.5, method).F
        errors.append(sampson_distance(F, CLEAN.left_px, CLEAN.right_px).mean())
    return float(np.median(errors))


@pytest.mark.parametrize("method", METHODS)
def test_a_plane_is_refused(method: str) -> None:
    plane, _ = with_wrong(plane_views(200, noise_px=0.4), 0.2)
    with pytest.raises(CalibrationError, match="matches are coplanar"):
        estimate_fundamental(plane.left_px, plane.right_px, 1.5, method)


@pytest.mark.parametrize("method", METHODS)
def test_random_matches_are_refused(method: str) -> None:
    seen, _ = with_wrong(views(100), 1.0)
    with pytest.raises(CalibrationError, match=r"no more than random matches|coplanar"):
        estimate_fundamental(seen.left_px, seen.right_px, 1.0, method)


@pytest.mark.parametrize("method", METHODS)
def test_a_camera_that_only_rotated(method: str) -> None:
    pose = RelativePose(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1e-9, 0, 0]))
    turned = views(100, noise_px=0.2, pose=pose)
    with pytest.raises(CalibrationError, match="camera that only rotated"):
        estimate_fundamental(turned.left_px, turned.right_px, 1.0, method)


def test_too_few_and_degenerate_points() -> None:
    seen = views(7)
    with pytest.raises(CalibrationError, match="7 different matches of 7"):
        estimate_fundamental(seen.left_px, seen.right_px)
    seen = views(30)
    with pytest.raises(CalibrationError, match="left points are coincident"):
        estimate_fundamental(np.full((30, 2), 211.0), seen.right_px)
    with pytest.raises(CalibrationError, match="right points are collinear"):
        estimate_fundamental(seen.left_px, np.column_stack((seen.right_px[:, 0], 0.5 * seen.right_px[:, 0])))


def test_invalid_values() -> None:
    seen = views(30)
    with pytest.raises(ConfigError, match="'lmeds' is not one of magsac, ransac"):
        estimate_fundamental(seen.left_px, seen.right_px, method="lmeds")
    for threshold_px in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ConfigError, match="above 0 and finite"):
            estimate_fundamental(seen.left_px, seen.right_px, threshold_px)


@pytest.mark.real_data
@pytest.mark.parametrize("method", METHODS)
def test_matches_alone_agree_with_the_calibration_of_euroc(stereo_data: Path, method: str) -> None:
    """The matches that fit the published calibration are within 0.5 px of the matrix of matches alone, on average."""
    dataset = EurocDataset(stereo_data / "euroc" / "V1_01_micro")
    left, right = dataset.rig.left, dataset.rig.right
    published = fundamental_from_pose(RelativePose.from_rig(dataset.rig), left.K, right.K)
    for pair in list(dataset)[::8]:
        matches = match_features(pair.left.pixels, pair.right.pixels).undistorted(left, right)
        fit = symmetric_epipolar_distance(published, matches.left_px, matches.right_px) < 1
        assert fit.sum() > 200
        F = estimate_fundamental(matches.left_px, matches.right_px, method=method).F
        distances = symmetric_epipolar_distance(F, matches.left_px[fit], matches.right_px[fit])
        assert distances.mean() <= 0.5

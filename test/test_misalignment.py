# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Misalignment of the right camera: points of a camera moved by known amounts, and rotated real images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.calibration.misalignment import (
    CorrectionLimits,
    Misalignment,
    MisalignmentEstimator,
    corrected_rig,
)
from stereo_depth_ros.calibration.row_error import RowMatches, match_rows
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.stages.rectification import Rectifier

RIG = StereoRig.from_rectified(410.0, 420.0, 330.0, 318.0, 205.0, 0.12, (640, 430))
NAMES = ("pitch", "yaw", "roll", "scale")


def moved(w_deg: F64 | list[float], scale: float = 0.0) -> tuple[F64, float]:
    return np.radians(np.array(w_deg)), scale


def frame(seed: int, w: F64, scale: float = 0.0, count: int = 300, noise_px: float = 0.15) -> RowMatches:
    """Row matches of a rectified pair when the rays of the right camera have rotated by w and f has changed."""
    random = np.random.default_rng(seed)
    left = random.uniform((40, 5), (635, 425), (count, 2))
    depth_m = random.uniform(0.7, 12, count)
    points = np.column_stack(((left[:, 0] - RIG.cx_left) / RIG.f_px, (left[:, 1] - RIG.cy) / RIG.fy_px, np.ones(count)))
    right = (points * depth_m[:, None] - [RIG.baseline_m, 0, 0]) @ cv2.Rodrigues(w)[0].T
    focal_px = np.array([RIG.f_px, RIG.fy_px]) * (1 + scale)
    right_px = right[:, :2] / right[:, 2:] * focal_px + [RIG.cx_right, RIG.cy]
    noise = noise_px * random.standard_normal((2, count, 2))
    return RowMatches(left + noise[0], right_px + noise[1])


def estimate(
    w: F64, scale: float = 0.0, frames: int = 10, seed: int = 0, reference: float | None = None, **how: float
) -> Misalignment:
    estimator = MisalignmentEstimator(RIG, reference)
    found = [estimator.add(frame(100 * seed + k, w, scale, **how)) for k in range(frames)][-1]  # type: ignore[arg-type]
    assert found is not None
    return found


@pytest.mark.parametrize("w_deg", [[0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.3], [-0.7, 0.9, 0.5], [0, 0, 0]])
@pytest.mark.parametrize("scale", [0.0, -0.004])
def test_without_noise_it_is_exact(w_deg: list[float], scale: float) -> None:
    found = estimate(np.radians(w_deg), scale, frames=3, noise_px=0)
    np.testing.assert_allclose(found.rotation_deg, w_deg, atol=1e-5)
    assert found.scale == pytest.approx(scale, abs=1e-7)
    assert found.residual_px < 1e-4


def test_row_errors_are_reported() -> None:
    found = estimate(np.radians([0.4, 0, 0]), frames=4, noise_px=0.1)
    expected_px = -RIG.fy_px * np.tan(np.radians(0.4))
    assert found.shift_px == pytest.approx(expected_px, abs=0.05)
    matches = [frame(k, np.radians([0.4, 0, 0]), noise_px=0.1) for k in range(4)]
    errors = np.concatenate([each.errors_px for each in matches])
    assert found.row_median_px == pytest.approx(np.median(np.abs(errors)))
    assert found.row_rms_px == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert (found.matches, found.frames) == (1200, 4)
    # Row errors contain the vertical part of the noise of both images
    assert found.residual_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)


def test_errors_fall_as_the_root_of_the_number() -> None:
    w = np.radians([0.2, -0.3, 0.1])

    def error(count: int) -> F64:
        draws = [estimate(w, 0.001, frames=4, seed=seed, count=count) for seed in range(24)]
        found = np.array([[*each.rotation_deg, np.degrees(each.scale)] for each in draws])
        rms: F64 = np.sqrt(np.mean((found - [0.2, -0.3, 0.1, np.degrees(0.001)]) ** 2, axis=0))
        return rms

    ratios = error(100) / error(400)
    # Ratios of two standard deviations of 24 draws are known to about 20 %
    assert (np.abs(ratios - 2) < 0.9).all()
    assert ratios.mean() == pytest.approx(2, rel=0.2)


def test_standard_deviations_are_those_of_many_draws() -> None:
    w = np.radians([0.2, -0.3, 0.1])
    draws = [estimate(w, 0.001, frames=12, seed=seed) for seed in range(40)]
    found = np.array([[*each.rotation_deg, each.scale] for each in draws])
    reported = np.array([[*each.rotation_sigma_deg, each.scale_sigma] for each in draws]).mean(axis=0)
    # The larger of two estimates is used, which is slightly conservative
    assert (reported / found.std(axis=0) > 0.75).all()
    assert (reported / found.std(axis=0) < 1.6).all()


def test_errors_common_to_a_frame_are_not_averaged_as_independent() -> None:
    """Row errors common to all matches of a frame, different in each frame, do not average out within the frame."""
    random = np.random.default_rng(0)
    estimator, found = MisalignmentEstimator(RIG), None
    for k in range(16):
        matches = frame(k, np.zeros(3), noise_px=0.05)
        matches.right_px[:, 1] += 0.5 * random.standard_normal()
        found = estimator.add(matches)
    assert found is not None
    pitch_sigma = np.degrees(0.5 / RIG.fy_px / np.sqrt(16))
    assert found.rotation_sigma_deg[0] == pytest.approx(pitch_sigma, rel=0.5)


def test_outliers_have_little_influence() -> None:
    w = np.radians([0.3, 0.2, -0.2])
    estimator, found = MisalignmentEstimator(RIG), None
    for k in range(6):
        matches = frame(k, w)
        matches.right_px[:45, 1] += np.random.default_rng(k).uniform(2, 20, 45)
        found = estimator.add(matches)
    assert found is not None
    np.testing.assert_allclose(found.rotation_deg, np.degrees(w), atol=0.02)


@pytest.mark.parametrize("axis", range(3))
def test_only_the_rotation_is_significant(axis: int) -> None:
    w = np.zeros(3)
    w[axis] = np.radians(0.3)
    found = estimate(w, reference=0.0)
    assert found.significant == (NAMES[axis],)
    assert found.detected


def test_an_aligned_rig_is_not_detected() -> None:
    for seed in range(20):
        assert not estimate(np.zeros(3), frames=3, seed=seed, count=60).detected


def test_small_rotations_are_reported_and_not_significant() -> None:
    found = estimate(np.radians([0.02, 0, 0]), frames=20)
    assert found.rotation_deg[0] == pytest.approx(0.02, abs=0.005)
    assert not found.detected


def test_scale_is_significant() -> None:
    assert estimate(np.zeros(3), 0.006).significant == ("scale",)


def test_yaw_is_significant_only_relative_to_the_reference() -> None:
    w = np.radians([0, 0.5, 0])
    assert not estimate(w).detected
    assert estimate(w).rotation_deg[1] == pytest.approx(0.5, abs=0.05)
    assert estimate(w, reference=0.0).significant == ("yaw",)
    assert not estimate(w, reference=0.5).detected
    assert estimate(np.radians([0, 0.9, 0]), reference=0.5).significant == ("yaw",)


def test_too_few() -> None:
    estimator = MisalignmentEstimator(RIG)
    assert estimator.add(frame(0, np.zeros(3))) is None
    assert estimator.add(frame(1, np.zeros(3))) is None
    assert estimator.add(frame(2, np.zeros(3))) is not None
    sparse = MisalignmentEstimator(RIG)
    assert [sparse.add(frame(k, np.zeros(3), count=20)) is None for k in range(6)] == [True] * 4 + [False] * 2


def test_frames_without_matches_do_no_harm() -> None:
    estimator, none = MisalignmentEstimator(RIG), RowMatches(np.empty((0, 2)), np.empty((0, 2)))
    for k in range(4):
        estimator.add(frame(k, np.radians([0.3, 0, 0])))
        found = estimator.add(none)
    assert found is not None
    assert found.rotation_deg[0] == pytest.approx(0.3, abs=0.02)


def test_old_frames_are_discarded() -> None:
    estimator = MisalignmentEstimator(RIG)
    for k in range(20):
        estimator.add(frame(k, np.radians([0.6, 0, 0])))
    for k in range(20):
        found = estimator.add(frame(k, np.zeros(3)))
    assert found is not None
    assert abs(found.rotation_deg[0]) < 0.01
    estimator.restart(RIG)
    assert estimator.add(frame(0, np.zeros(3))) is None


def raw_rig() -> StereoRig:
    """A rig with distortion, unequal cameras and a rectification."""
    K_left = np.array([[500.0, 0, 322], [0, 505, 207], [0, 0, 1]])
    K_right = np.array([[520.0, 0, 310], [0, 517, 222], [0, 0, 1]])
    R = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0]
    D = [-0.2, 0.05, 0.001, -0.0005, 0.0]
    return StereoRig.from_calibration(K_left, D, K_right, D, R, [-0.12, 0.004, 0.002], (640, 430))


def rectified(points_px: F64, rig: StereoRig) -> F64:
    """Raw points of the right camera, float64 (N, 2), rectified."""
    side = rig.right
    moved = cv2.undistortPoints(points_px[:, None], side.K, side.D, None, side.R, side.P[:, :3])
    return np.asarray(moved[:, 0], np.float64)


@dataclass(frozen=True)
class Turned:
    """Raw right points of a camera that has rotated, and their true rectified points."""

    raw_px: F64
    true_px: F64


def turned(rig: StereoRig, w: F64) -> Turned:
    side, random = rig.right, np.random.default_rng(2)
    true_px = random.uniform((60, 40), (580, 380), (80, 2))
    rays = np.column_stack((true_px, np.ones(80))) @ np.linalg.inv(side.P[:, :3]).T @ cv2.Rodrigues(w)[0].T @ side.R
    raw = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), side.K, side.D)[0][:, 0]
    return Turned(np.asarray(raw, np.float64), true_px)


def test_corrected_rig_rectifies_to_the_true_points() -> None:
    rig, w = raw_rig(), np.radians([0.4, -0.3, 0.5])
    seen = turned(rig, w)
    off = estimate(np.zeros(3))
    corrected = corrected_rig(rig, replace(off, rotation_deg=np.degrees(w), scale=0.0), reference_yaw_deg=0.0)
    assert np.abs(rectified(seen.raw_px, rig) - seen.true_px).max() > 4
    np.testing.assert_allclose(rectified(seen.raw_px, corrected), seen.true_px, atol=1e-3)
    np.testing.assert_array_equal(corrected.right.P, rig.right.P)
    assert corrected.left is rig.left


def test_the_reference_yaw_is_kept() -> None:
    rig = raw_rig()
    found = replace(estimate(np.zeros(3)), rotation_deg=np.array([0.2, 0.7, 0.1]), scale=0.0)
    unknown, known = corrected_rig(rig, found), corrected_rig(rig, found, reference_yaw_deg=0.5)
    for corrected, yaw_deg in ((unknown, 0.0), (known, 0.2)):
        expected = cv2.Rodrigues(np.radians([0.2, yaw_deg, 0.1]))[0]
        np.testing.assert_allclose(rig.right.R @ corrected.right.R.T, expected, atol=1e-12)
        np.testing.assert_array_equal(corrected.right.K, rig.right.K)


def test_scale_is_corrected() -> None:
    rig = raw_rig()
    larger = replace(rig, right=replace(rig.right, K=rig.right.K * [[1.004, 1.004, 1], [1.004, 1.004, 1], [1, 1, 1]]))
    found = replace(estimate(np.zeros(3)), rotation_deg=np.zeros(3), scale=0.004)
    np.testing.assert_allclose(corrected_rig(rig, found).right.K, larger.right.K, rtol=1e-12)


def test_corrections_have_limits() -> None:
    found = estimate(np.zeros(3))
    with pytest.raises(
        CalibrationError, match=r"rotated by 1\.200 degrees, limit of a correction 1: .*calibrate again"
    ):
        corrected_rig(RIG, replace(found, rotation_deg=np.array([0.1, -1.2, 0.0])), reference_yaw_deg=0.0)
    with pytest.raises(CalibrationError, match=r"changed by -2\.00 %, limit of a correction 1 %"):
        corrected_rig(RIG, replace(found, rotation_deg=np.zeros(3), scale=-0.02))
    with pytest.raises(CalibrationError, match=r"limit of a correction 0\.05"):
        corrected_rig(RIG, replace(found, rotation_deg=np.array([0.1, 0, 0])), CorrectionLimits(rotation_deg=0.05))


@dataclass(frozen=True)
class Street:
    """A real sequence, the misalignment estimated from its first half, and what its second half gives as it is."""

    rig: StereoRig
    pairs: list[tuple[U8, U8]]
    reference: Misalignment
    density: float
    row_px: float

    def turned(self, axis: int, degrees: float) -> list[tuple[U8, U8]]:
        """The second half with the right images rotated."""
        w, K = np.zeros(3), self.rig.right.P[:, :3]
        w[axis] = np.radians(degrees)
        H = K @ cv2.Rodrigues(w)[0] @ np.linalg.inv(K)
        size = (self.rig.width, self.rig.height)
        half = self.pairs[10:]
        return [(left, np.asarray(cv2.warpPerspective(right, H, size), np.uint8)) for left, right in half]


@pytest.fixture(scope="module")
def street(stereo_data: Path) -> Street:
    dataset = KittiDataset(stereo_data / "kitti_odometry" / "seqA_1226x370")
    pairs = [(each.left.pixels, each.right.pixels) for each in dataset]
    found = follow(MisalignmentEstimator(dataset.rig), pairs[:10])[-1]
    assert found is not None
    return Street(dataset.rig, pairs, found, *density_and_rows(dataset.rig, pairs[10:]))


def follow(estimator: MisalignmentEstimator, pairs: list[tuple[U8, U8]]) -> list[Misalignment | None]:
    return [estimator.add(match_rows(left, right)) for left, right in pairs]


def density_and_rows(rig: StereoRig, pairs: list[tuple[U8, U8]]) -> tuple[float, float]:
    """Share of pixels with a disparity, and median row error, px, of pairs rectified with the rig."""
    rectifier, matcher = Rectifier(rig), create_matcher("sgm", MatchingConfig(num_disparities=128))
    densities, errors = [], []
    for left, right in pairs[::3]:
        straight = rectifier.rectify_right(right)
        densities.append(np.isfinite(matcher.match(left, straight).disparity_px).mean())
        errors.append(match_rows(left, straight).errors_px)
    return float(np.mean(densities)), float(np.median(np.abs(np.concatenate(errors))))


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("axis", "degrees", "tolerance_deg"), [(0, 0.3, 0.03), (1, 0.3, 0.1), (1, -0.3, 0.1), (2, 0.3, 0.03)]
)
def test_a_street_with_the_right_camera_rotated(
    street: Street, axis: int, degrees: float, tolerance_deg: float
) -> None:
    """Detected within 20 frames, estimated, and corrected: density and row errors as before, to 5 %."""
    reference = float(street.reference.rotation_deg[1])
    pairs = street.turned(axis, degrees)
    reported = follow(MisalignmentEstimator(street.rig, reference), pairs)
    found = reported[-1]
    assert found is not None
    assert any(each is not None and NAMES[axis] in each.significant for each in reported)
    assert abs(found.rotation_deg[axis] - street.reference.rotation_deg[axis] - degrees) <= tolerance_deg
    corrected = corrected_rig(street.rig, found, reference_yaw_deg=reference)
    density_again, row_again_px = density_and_rows(corrected, pairs)
    assert density_again == pytest.approx(street.density, rel=0.05)
    assert row_again_px == pytest.approx(street.row_px, rel=0.05)
    if degrees > 0:  # in the other direction a yaw reduces the keystone of this rig
        disturbed_density, disturbed_row_px = density_and_rows(street.rig, pairs)
        assert disturbed_density < 0.95 * street.density
        assert disturbed_row_px > 1.05 * street.row_px


@pytest.mark.real_data
def test_an_unchanged_street(street: Street) -> None:
    """Nothing is detected in the second half, relative to the yaw of the first one or without a reference."""
    matches = [match_rows(left, right) for left, right in street.pairs[10:]]
    for reference in (float(street.reference.rotation_deg[1]), None):
        estimator = MisalignmentEstimator(street.rig, reference)
        reported = [estimator.add(each) for each in matches]
        assert reported[-1] is not None
        assert not any(each is not None and each.detected for each in reported)
    assert street.reference.rotation_deg[1] == pytest.approx(0.55, abs=0.1)  # a keystone of the published calibration

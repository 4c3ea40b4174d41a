# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The closed loop of corrections: pairs of a camera that has rotated, rectified with the rig of the loop."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.calibration.auto_correction import MIN_FRAMES, STALE_PAIRS, AutoCorrection
from stereo_depth_ros.calibration.misalignment import CorrectionLimits
from stereo_depth_ros.calibration.row_error import RowMatches
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64

K_LEFT = np.array([[500.0, 0, 322], [0, 505, 207], [0, 0, 1]])
K_RIGHT = np.array([[520.0, 0, 310], [0, 517, 222], [0, 0, 1]])
D = [-0.1, 0.02, 0.001, -0.0005, 0.0]
POSE = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0], [-0.12, 0.004, 0.002]
RIG = StereoRig.from_calibration(K_LEFT, D, K_RIGHT, D, *POSE, (640, 430))


def pair(seed: int, rig: StereoRig, w: F64, noise_px: float = 0.15) -> RowMatches:
    """Row matches of a pair rectified with ``rig`` whose right camera has rotated by w since RIG was calibrated."""
    random = np.random.default_rng(seed)
    depth_m = random.uniform(0.8, 12, 250)
    left = random.uniform((30, 20), (610, 410), (250, 2))
    points = np.column_stack((left, np.ones(250))) @ np.linalg.inv(RIG.left.P[:, :3]).T * depth_m[:, None]
    rays = (points - [RIG.baseline_m, 0, 0]) @ cv2.Rodrigues(w)[0].T @ RIG.right.R
    raw = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), RIG.right.K, RIG.right.D)[0]
    side = rig.right
    right = cv2.undistortPoints(raw, side.K, side.D, None, side.R, side.P[:, :3])[:, 0]
    noise = noise_px * random.standard_normal((2, 250, 2))
    return RowMatches(left + noise[0], np.asarray(right + noise[1], np.float64))


def run(loop: AutoCorrection, w: F64, pairs: int, seed: int = 0) -> list[bool]:
    """Whether each pair led to a correction; the first pairs after one are rectified as before."""
    used, changed = [loop.rig] * STALE_PAIRS, []
    for number in range(pairs):
        used.append(loop.rig)
        changed.append(loop.add(pair(seed + number, used[-1 - STALE_PAIRS], w))[1])
    return changed


def row_error(rig: StereoRig, w: F64) -> float:
    return float(np.sqrt(np.mean(pair(999, rig, w, noise_px=0).errors_px ** 2)))


@pytest.mark.parametrize("w_deg", [[0.3, 0, 0], [0, 0.4, 0], [0, 0, 0.3], [-0.5, 0.3, 0.4]])
def test_row_errors_converge_and_stay(w_deg: list[float]) -> None:
    w, loop = np.radians(w_deg), AutoCorrection(RIG, reference_yaw_deg=0.0)
    changed = run(loop, w, 40)
    assert changed.index(True) == MIN_FRAMES - 1
    assert 1 <= sum(changed) <= 2
    assert not any(changed[20:])
    assert row_error(RIG, w) > 0.2
    assert row_error(loop.rig, w) < 0.05
    np.testing.assert_allclose(loop.correction.rotation_deg, w_deg, atol=0.03)
    assert loop.correction.steps == sum(changed)
    assert loop.refusal == ""


def test_without_a_reference_yaw_is_not_corrected() -> None:
    loop = AutoCorrection(RIG)
    assert not any(run(loop, np.radians([0.0, 0.5, 0.0]), 20))
    run(loop, np.radians([0.3, 0.5, 0.0]), 30, seed=50)
    np.testing.assert_allclose(loop.correction.rotation_deg, [0.3, 0, 0], atol=0.03)


def test_the_reference_yaw_is_kept() -> None:
    assert not any(run(AutoCorrection(RIG, reference_yaw_deg=0.5), np.radians([0.0, 0.5, 0.0]), 20))
    loop = AutoCorrection(RIG, reference_yaw_deg=0.5)
    run(loop, np.radians([0.0, 0.9, 0.0]), 40, seed=50)
    np.testing.assert_allclose(loop.correction.rotation_deg, [0, 0.4, 0], atol=0.05)


def test_an_aligned_rig_is_not_corrected() -> None:
    loop = AutoCorrection(RIG)
    assert not any(run(loop, np.radians([0.02, 0.05, -0.02]), 60))
    assert loop.rig is RIG
    assert loop.correction.steps == 0
    np.testing.assert_array_equal(loop.correction.rotation_deg, 0)


def test_noise_causes_no_corrections() -> None:
    """The correction is the same hundreds of pairs later."""
    w, loop = np.radians([0.3, 0, 0.2]), AutoCorrection(RIG)
    run(loop, w, 20)
    steps = loop.correction.steps
    run(loop, w, 200, seed=500)
    assert loop.correction.steps == steps


def test_pairs_in_transit_are_not_counted_twice() -> None:
    """They arrive after a correction without it: counted as new, they would cause another correction."""
    w, loop = np.radians([0.3, 0, 0]), AutoCorrection(RIG)
    run(loop, w, 12)
    assert loop.correction.steps == 1
    assert loop.correction.rotation_deg[0] == pytest.approx(0.3, abs=0.02)


def test_a_second_misalignment_is_corrected_too() -> None:
    loop = AutoCorrection(RIG)
    run(loop, np.radians([0.3, 0, 0]), 30)
    run(loop, np.radians([0.3, 0, -0.4]), 60, seed=100)
    np.testing.assert_allclose(loop.correction.rotation_deg[[0, 2]], [0.3, -0.4], atol=0.03)


def test_a_correction_beyond_the_limit_is_refused() -> None:
    loop = AutoCorrection(RIG, CorrectionLimits(rotation_deg=0.25))
    assert not any(run(loop, np.radians([0.3, 0, 0]), 20))
    assert loop.rig is RIG
    assert "rotated by 0." in loop.refusal
    assert "limit of a correction 0.25" in loop.refusal


def test_the_limit_applies_to_the_total_correction() -> None:
    loop = AutoCorrection(RIG, CorrectionLimits(rotation_deg=0.5))
    run(loop, np.radians([0.3, 0, 0]), 30)
    kept = loop.rig
    run(loop, np.radians([0.7, 0, 0]), 40, seed=100)
    assert loop.rig is kept
    assert "the total correction would be 0.7" in loop.refusal
    run(loop, np.radians([0.3, 0, 0]), 40, seed=200)
    assert loop.refusal == ""


def test_p_does_not_change() -> None:
    loop = AutoCorrection(RIG)
    run(loop, np.radians([0.3, 0.2, 0.1]), 20)
    np.testing.assert_array_equal(loop.rig.right.P, RIG.right.P)
    assert loop.rig.left is RIG.left

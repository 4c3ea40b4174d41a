# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The check of a stereo rig against a range sensor, on rendered images and sweeps with known errors."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np
import pytest
from rendered_lidar import CAMERA_AXES, lidar_points
from stereo_bags import HEIGHT, WIDTH, sequence

from stereo_depth_ros.calibration.range_check import Figure, RangeCheck, RangeChecker
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.ranging.projection import project, rectified_from_left
from stereo_depth_ros.stages.rectification import Rectifier

LEFT_LIDAR = Pose(CAMERA_AXES, np.array([0.12, -0.25, -0.1]))
FRAMES = 3
RIG = sequence(FRAMES).rig
DEGREES = tuple[float, float, float]
STRAIGHT: DEGREES = (0.0, 0.0, 0.0)


@functools.cache
def sweep(index: int) -> F32:
    made = sequence(FRAMES)
    return lidar_points(made.scene, Pose(*made.pose(index)) @ LEFT_LIDAR, seed=index, step_deg=0.5, azimuth_deg=48)


@functools.cache
def matched(index: int, matcher: str) -> F32:
    """By a matcher, or the truth with the noise of one."""
    frame = sequence(FRAMES)[index]
    if matcher != "truth":
        pair = Rectifier(RIG).rectify(frame.pair)
        return create_matcher(matcher, MatchingConfig(num_disparities=48)).match(pair.left, pair.right).disparity_px
    noise = np.random.default_rng(index).normal(0, 0.2, (HEIGHT, WIDTH))
    return np.where(frame.occluded, np.nan, frame.truth_disparity_px + noise).astype(np.float32)


def check(baseline: float, offset_px: float, turn_deg: DEGREES, matcher: str = "truth") -> RangeCheck:
    """With a calibration whose baseline is too large by a share, and a transform of the sensor that is turned."""
    right = Triangulation.from_rig(RIG)
    wrong = dataclasses.replace(right, baseline_m=right.baseline_m * (1 + baseline))
    turn = Pose(np.asarray(cv2.Rodrigues(np.radians(turn_deg))[0], np.float64), np.zeros(3))
    pose, checker = turn @ rectified_from_left(RIG) @ LEFT_LIDAR, RangeChecker(wrong)
    for index in range(FRAMES):
        seen = project(sweep(index), 0.02, pose, wrong, (WIDTH, HEIGHT)).index
        points = pose.apply(sweep(index)[seen[seen >= 0]].astype(np.float64)).astype(np.float32)
        checker.add(matched(index, matcher) + np.float32(offset_px), points)
    found = checker.check()
    assert found is not None
    assert found.pairs == FRAMES
    return found


@pytest.mark.parametrize("matcher", ["truth", "sgm"])
@pytest.mark.parametrize(
    ("baseline", "offset_px", "turn_deg"),
    [
        (0.0, 0.0, STRAIGHT),
        (0.02, 0.0, STRAIGHT),
        (0.0, 0.4, STRAIGHT),
        (0.0, 0.0, (0.0, 0.3, 0.0)),
        (-0.03, -0.5, (0.5, -0.8, 0.6)),
    ],
)
def test_known_errors_are_found(baseline: float, offset_px: float, turn_deg: DEGREES, matcher: str) -> None:
    found = check(baseline, offset_px, turn_deg, matcher)
    # two small rotations about different axes commute but for their product
    expected = (1 / (1 + baseline) - 1, offset_px, *(-np.array(turn_deg)))
    for (name, figure), value in zip(found.figures.items(), expected, strict=True):
        assert figure.observable, name
        assert abs(figure.value - value) <= 3 * figure.sigma, (name, figure, value)
        if abs(value) > max(figure.limit, 6 * figure.sigma):
            assert figure.deviates, (name, figure)
        if not value:
            assert not figure.deviates, (name, figure)


def test_a_wall_parallel_to_the_images_does_not_tell_scale_from_offset() -> None:
    right = Triangulation.from_rig(RIG)
    rng, checker = np.random.default_rng(2), RangeChecker(right)
    y, x = (each.ravel() for each in np.mgrid[2:HEIGHT:4, 2:WIDTH:3])
    points = np.stack([(x - right.cx_px) / right.f_px, (y - right.cy_px) / right.fy_px, np.ones(x.size)], axis=1) * 2.5
    disparity = right.f_px * right.baseline_m / 2.5 + right.doffs_px
    checker.add(rng.normal(disparity + 0.3, 0.1, (HEIGHT, WIDTH)).astype(np.float32), points.astype(np.float32))
    found = checker.check()
    assert found is not None
    assert not found.scale.observable
    assert not found.offset.observable
    assert not found.roll.observable
    assert not any(figure.deviates for figure in found.figures.values())


def test_of_too_little_there_is_none() -> None:
    checker = RangeChecker(Triangulation.from_rig(RIG))
    assert checker.check() is None
    checker.add(matched(0, "truth"), np.full((3000, 3), (0.0, 0.0, 3.0), np.float32))  # all in one tile
    assert checker.check() is None
    checker.add(np.full((HEIGHT, WIDTH), np.nan, np.float32), np.full((3000, 3), (0.0, 0.0, 3.0), np.float32))
    assert checker.check() is None


def test_what_deviates_is_above_its_limit_and_not_by_chance() -> None:
    assert Figure(0.02, 0.004, 0.01).deviates
    assert not Figure(0.02, 0.008, 0.01).deviates  # by chance
    assert not Figure(0.009, 0.001, 0.01).deviates  # too little
    assert not Figure(9.0, 0.021, 0.01).deviates  # not observable

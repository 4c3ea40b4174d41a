# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The checks of stamps, images, rows and disparities, separately."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import pytest

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.diagnosis.checks.disparities import check_depths
from stereo_depth_ros.diagnosis.checks.images import check_exposure, check_two_cameras
from stereo_depth_ros.diagnosis.checks.rows import RowMatching, check_rows
from stereo_depth_ros.diagnosis.checks.streams import check_streams
from stereo_depth_ros.diagnosis.finding import Finding, Level

F64: TypeAlias = Any

# stamps


def stamps(count: int, late_ns: int = 0) -> list[int]:
    return [10**9 + 100_000_000 * index + late_ns for index in range(count)]


def streams(left: list[int], right: list[int]) -> dict[str, Finding]:
    return {finding.check: finding for finding in check_streams(left, right)}


def test_healthy_stamps() -> None:
    found = streams(stamps(20), stamps(20))
    assert max(finding.level for finding in found.values()) is Level.OK
    assert found["rates"].figures == {"left_hz": 10.0, "right_hz": 10.0}


def test_stamps_that_are_never_equal_get_a_tolerance() -> None:
    found = streams(stamps(20), stamps(20, 6_000_000))
    assert found["pairs"].level is Level.ERROR
    assert found["pairs"].settings == {"approximate_sync": True, "approximate_sync_tolerance_seconds": 0.008}
    assert "pair stamps that differ" in found["pairs"].remedy
    assert found["stamp offset"].figures["median_ms"] == pytest.approx(6.0)
    assert found["stamp offset"].level is Level.WARNING


def test_stamps_that_are_too_far_apart() -> None:
    found = streams(stamps(20), stamps(20, 40_000_000))
    assert found["pairs"].level is Level.ERROR
    assert "synchronize the cameras" in found["pairs"].remedy
    assert "stamp offset" not in found
    assert (
        "stamps are 40.000 ms apart: if the images were taken together, set approximate_sync" in found["pairs"].remedy
    )


def test_stamps_that_are_not_set_are_no_matter_of_pairs() -> None:
    found = streams([0] * 20, [0] * 20)
    assert [found[f"{side} stamps"].level for side in ("left", "right")] == [Level.ERROR] * 2
    assert found["pairs"].level is Level.SKIPPED


def test_dropped_images() -> None:
    right = [stamp for index, stamp in enumerate(stamps(20)) if index not in (4, 5, 11)]
    found = streams(stamps(20), right)
    assert found["pairs"].level is Level.OK, "all 17 right images have a partner"
    assert found["right drops"].value == "3 of 20 images missing"
    assert found["right drops"].level is Level.WARNING
    assert found["left drops"].level is Level.OK


def test_rates_that_differ() -> None:
    found = streams(stamps(20), stamps(20)[::2])
    assert found["rates"].level is Level.WARNING
    assert found["rates"].value == "10.00, 5.00 Hz"


def test_stamps_that_are_not_set_or_not_rising() -> None:
    assert streams([0, 0], stamps(2))["left stamps"].value == "all 0, which means not set"
    looped = [*stamps(5), *stamps(5), 10**9 + 400_000_000]
    assert streams(looped, stamps(5))["left stamps"].value == "1 equal, 1 backwards of 11"


# images


def test_exposure() -> None:
    noise = np.random.default_rng(3).normal(120, 30, (60, 80)).clip(0, 255).astype(np.uint8)
    assert check_exposure([noise], "left").level is Level.OK
    assert "black" in check_exposure([noise // 20], "left").remedy
    assert "white" in check_exposure([np.full_like(noise, 255)], "left").remedy
    assert "empty" in check_exposure([np.full_like(noise, 90)], "left").remedy
    glare = np.where(np.arange(60)[:, None] < 18, np.uint8(255), noise)
    assert check_exposure([glare], "left").level is Level.WARNING
    assert check_two_cameras([noise, noise], [noise[::-1], noise[::-1]]).level is Level.OK
    assert "both topics show one camera" in check_two_cameras([noise], [noise.copy()]).remedy
    assert "left is 80x60, right is 70x60" in check_two_cameras([noise], [noise[:, :70]]).value


# rows

WIDTH, HEIGHT, F_PX = 640, 480, 430.0


def matching(error: Callable[[F64, F64], F64], disparity: tuple[float, float] = (5.0, 60.0)) -> RowMatching:
    """Points all over the image; row error, y_left - y_right, by their place, and noise of 0.1 px."""
    random = np.random.default_rng(11)
    left = random.uniform((70, 0), (WIDTH, HEIGHT), (600, 2))
    d = random.uniform(*disparity, 600)
    right = np.stack([left[:, 0] - d, left[:, 1] - error(*left.T) - random.normal(0, 0.1, 600)], axis=1)
    return RowMatching(left, right, 1)


def rows(error: Callable[[F64, F64], F64]) -> Finding:
    return check_rows(matching(error), None, WIDTH, HEIGHT, F_PX)


@pytest.mark.parametrize(
    ("shift_px", "level"), [(0.45, Level.OK), (0.55, Level.WARNING), (0.95, Level.WARNING), (1.05, Level.ERROR)]
)
def test_limits_of_the_rows(shift_px: float, level: Level) -> None:
    found = rows(lambda x, y: np.full_like(x, shift_px))
    assert found.level is level
    assert found.figures["median_px"] == pytest.approx(shift_px, abs=0.02)


def test_rows_that_are_off_in_a_part_of_the_image() -> None:
    found = rows(lambda x, y: np.where(x > 500, 2.6, 0.0))
    assert found.figures["median_px"] < 0.2
    assert found.level is Level.WARNING


@pytest.mark.parametrize(
    ("error", "figure", "value_px", "words"),
    [
        (lambda x, y: 1.5 + 0 * x, "shift_px", 1.5, "px higher everywhere: the cameras are pitched"),
        (lambda x, y: -1.5 + 0 * x, "shift_px", -1.5, "px lower everywhere: the cameras are pitched"),
        (lambda x, y: 0.01 * (x - 320), "across_px", 6.4, "px across: the cameras are rolled by about 0.5"),
        (lambda x, y: -0.015 * (y - 240), "down_px", -7.2, "px downwards: the focal lengths differ by about 1.5"),
        (lambda x, y: 2.5 * np.sin(x / 20), "shift_px", 0.0, "no simple pattern"),
    ],
)
def test_the_pattern_of_the_row_errors(
    error: Callable[[F64, F64], F64], figure: str, value_px: float, words: str
) -> None:
    found = rows(error)
    assert found.level is Level.ERROR
    assert words in found.remedy
    # three standard deviations of the plane through 600 points: noise 0.1 px, or 1.8 px where the residual is a wave
    assert found.figures[figure] == pytest.approx(value_px, abs=0.3 if value_px == 0 else 0.05)


@pytest.mark.parametrize(
    ("disparity", "doffs_px", "search"),
    [
        ((5.0, 60.0), 0.0, (0, 80)),  # a margin of 15 % beyond 60 px: to 70
        ((100.0, 150.0), 0.0, (77, 112)),  # far from infinity: from 100 - 23
        ((-20.0, 10.0), -31.0, (-31, 48)),  # infinity is at -31, the margin ends at 16
        ((14.0, 30.0), 9.5, (0, 48)),
    ],
)
def test_the_search_covers_the_disparities(
    disparity: tuple[float, float], doffs_px: float, search: tuple[int, int]
) -> None:
    rig = StereoRig.from_rectified(F_PX, 420.0, 300.0 + doffs_px, 300.0, 240.0, 0.12, (WIDTH, HEIGHT))
    found = {finding.check: finding for finding in check_depths(matching(lambda x, y: 0 * x, disparity), rig, True)}
    settings = found["disparities"].settings
    assert (settings["min_disparity"], settings["disparity_range"]) == search
    near_m = F_PX * 0.12 / (disparity[1] - doffs_px)
    assert found["depths of the features"].figures["near_m"] == pytest.approx(near_m, rel=0.05)

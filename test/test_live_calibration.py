# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Live calibration with rendered boards: which views are added, the messages, the result."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered_boards import FISHEYE, SIZE, SQUARE_M, chessboard_photographs

from stereo_depth_ros.calibration.board_options import create_board
from stereo_depth_ros.calibration.live_calibration import GOOD_VIEWS, LiveCalibration, ViewStatus
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.datasets.stereo_images import open_stereo_images
from stereo_depth_ros.plots.operator_overlay import operator_overlay

BOARD = create_board("chessboard", (7, 5), SQUARE_M)
EMPTY = np.full(SIZE[::-1], 80, np.uint8)


@pytest.fixture(scope="module")
def photographs() -> list[tuple[U8, U8]]:
    """Different views."""
    return list(chessboard_photographs())


def live(max_motion_px: float = 0.0) -> LiveCalibration:
    return LiveCalibration(BOARD, "equidistant", max_motion_px)


def test_views_are_added_and_calibrated(photographs: list[tuple[U8, U8]]) -> None:
    collected = live()
    looks = [collected.add(str(number), *pair) for number, pair in enumerate(photographs)]
    assert looks.count(ViewStatus.ADDED) == len(collected.views) >= 6
    result = collected.calibrate()
    assert collected.result is result
    assert result.baseline_m == pytest.approx(np.linalg.norm(FISHEYE.rig[3:]), abs=1e-3)
    assert result.left.K[0, 0] == pytest.approx(FISHEYE.left[0], abs=1.0)
    assert result.rms_stereo_px < 0.2


def test_the_coverage_is_that_of_the_image_circle(photographs: list[tuple[U8, U8]]) -> None:
    whole, collected = live(), live()
    rows, columns = np.indices(SIZE[::-1])
    dark = np.hypot(columns - 203, rows - 147) > 190
    for number, (left, right) in enumerate(photographs):
        whole.add(str(number), left, right)
        collected.add(str(number), np.where(dark, 2, left).astype(np.uint8), np.where(dark, 2, right).astype(np.uint8))
    left_circle, right_circle = collected.calibrate().circles
    assert left_circle is not None and right_circle is not None
    assert left_circle.radius == pytest.approx(190, abs=1)
    assert collected.coverage.x > whole.coverage.x + 0.01
    assert whole.calibrate().circles == (None, None)


def test_rejected_pairs_have_a_reason(photographs: list[tuple[U8, U8]]) -> None:
    collected, (left, right) = live(), photographs[0]
    assert collected.add("a", EMPTY, EMPTY) is ViewStatus.NOT_FOUND
    assert collected.add("b", left, EMPTY) is ViewStatus.LEFT_ONLY
    assert collected.add("c", EMPTY, right) is ViewStatus.RIGHT_ONLY
    assert collected.add("d", left, right) is ViewStatus.ADDED
    assert collected.add("e", left, right) is ViewStatus.DUPLICATE
    assert len(collected.views) == 1
    assert "right camera" in ViewStatus.LEFT_ONLY.value
    assert "left camera" in ViewStatus.RIGHT_ONLY.value


def test_a_board_has_to_be_held_still(photographs: list[tuple[U8, U8]]) -> None:
    collected = live(max_motion_px=2.0)
    one, other = photographs[0], photographs[1]
    assert [collected.add("x", *pair) for pair in (one, other, other, one, one)] == [
        *(ViewStatus.MOVING, ViewStatus.MOVING, ViewStatus.ADDED, ViewStatus.MOVING, ViewStatus.ADDED),
    ]


@pytest.mark.parametrize("side", [0, 1])
def test_blurred_images_are_not_added(photographs: list[tuple[U8, U8]], side: int) -> None:
    pair = list(photographs[1])
    pair[side] = np.asarray(cv2.GaussianBlur(pair[side], (0, 0), 3.0), np.uint8)
    collected = live()
    assert collected.add("a", pair[0], pair[1]) is ViewStatus.BLURRED
    assert not collected.views
    assert collected.add("b", *photographs[1]) is ViewStatus.ADDED


def test_advice_states_what_is_missing(photographs: list[tuple[U8, U8]]) -> None:
    collected = live()
    assert collected.advice[0] == "show the board to both cameras"
    assert collected.advice[-1] == f"show {GOOD_VIEWS} more views of {GOOD_VIEWS}"
    collected.add("a", *photographs[0])
    assert any("move the board to the" in text for text in collected.advice)
    assert collected.advice[-1] == f"show {GOOD_VIEWS - 1} more views of {GOOD_VIEWS}"


def test_too_few_views_are_not_calibrated(photographs: list[tuple[U8, U8]]) -> None:
    collected = live()
    collected.add("a", *photographs[0])
    with pytest.raises(CalibrationError, match=r"1 views so far, at least 5 are needed: .*show 19 more views"):
        collected.calibrate()
    assert collected.result is None


def test_images_of_another_size(photographs: list[tuple[U8, U8]]) -> None:
    collected, (left, right) = live(), photographs[0]
    collected.add("a", left, right)
    with pytest.raises(CalibrationError, match=r"right image: 400x299, previous images 400x300, .*restart"):
        collected.add("b", left, right[:-1])


def test_overlay_shows_views_and_advice(photographs: list[tuple[U8, U8]]) -> None:
    collected, (left, right) = live(), photographs[0]
    blank = operator_overlay(left, [], None, collected.coverage, "", collected.advice)
    collected.add("a", left, right)
    assert collected.seen is not None
    taken = [view.left.image_px for view in collected.views]
    image = operator_overlay(
        left, taken, collected.seen.image_px, collected.coverage, ViewStatus.ADDED.value, collected.advice
    )
    assert image.shape[1] == left.shape[1]
    assert image.shape[0] > left.shape[0] + 100
    shown = (image[: left.shape[0]] != blank[: left.shape[0]]).any(axis=2)
    x, y = collected.seen.image_px.mean(axis=0)
    rows, columns = np.nonzero(shown)
    assert shown.sum() > 200
    assert abs(rows.mean() - y) < 20 and abs(columns.mean() - x) < 20


@pytest.mark.real_data
def test_the_chessboards_of_opencv(stereo_data: Path) -> None:
    """In sequence: of 13 views those that differ are added, and give the calibration of all."""
    collected = LiveCalibration(create_board("chessboard", (9, 6), 0.025), "plumb_bob", 0.0)
    for pair in open_stereo_images(stereo_data / "opencv_samples" / "chessboard_stereo"):
        collected.add(pair.name, pair.left, pair.right)
    assert 8 <= len(collected.views) <= 13
    result = collected.calibrate()
    assert result.rms_stereo_px <= 0.35
    assert abs(1e3 * result.baseline_m - 83.2) <= 1

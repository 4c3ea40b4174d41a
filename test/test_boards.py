# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boards are detected in images of known cameras, at the right positions and in the right order."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from rendered_boards import (
    FISHEYE,
    PINHOLE,
    SIZE,
    SQUARE_M,
    KnownRig,
    aprilgrid_print,
    charuco_print,
    chessboard_points,
    chessboard_print,
    photograph,
    poses,
)

from stereo_depth_ros.calibration.board_options import create_board
from stereo_depth_ros.calibration.boards import Board, Corners, edge_width_px
from stereo_depth_ros.calibration.projection import project
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F64, U8

needs_detectors = pytest.mark.skipif(
    not hasattr(getattr(cv2, "aruco", None), "CharucoDetector"), reason="OpenCV before 4.7 has no marker detectors"
)


@dataclass(frozen=True)
class Sample:
    """A board, its print, the size of a cell of the print, and all of its corners."""

    board: Board
    print_: tuple[U8, F64]
    cell_px: int
    cell_m: float
    board_m: F64


def chessboard() -> Sample:
    return Sample(
        create_board("chessboard", (7, 5), SQUARE_M), chessboard_print(7, 5), 40, SQUARE_M, chessboard_points(7, 5)
    )


def charuco() -> Sample:
    board_m = chessboard_points(6, 4) + np.array([SQUARE_M, SQUARE_M, 0])
    return Sample(create_board("charuco", (7, 5), SQUARE_M), charuco_print(7, 5, 0.75), 40, SQUARE_M, board_m)


def aprilgrid(border_bits: int = 2, turns: int = 0) -> Sample:
    tag_m, columns, rows = 0.06, 4, 3
    board = create_board("aprilgrid", (columns, rows), tag_m)
    origins = tag_m * 1.3 * np.array([[tag % columns, tag // columns] for tag in range(columns * rows)])
    corners = (origins[:, None] + tag_m * np.array([[0, 1], [1, 1], [1, 0], [0, 0]])).reshape(-1, 2)
    board_m = np.column_stack((corners, np.zeros(len(corners))))
    return Sample(board, aprilgrid_print(columns, rows, 0.3, border_bits, turns), 80, tag_m, board_m)


def found_and_exact(sample: Sample, rig: KnownRig, pose: F64) -> tuple[Corners, F64, Corners, F64]:
    """Detected and exact corners of both cameras; fails where the board is not found."""
    left, right = (
        sample.board.detect(each) for each in photograph(sample.print_, sample.cell_px, sample.cell_m, rig, pose)
    )
    assert left is not None and right is not None, "board not found"
    right = sample.board.align(left, right)
    exact = [
        project(rig.model, side, at, corners.board_m).image_px
        for side, at, corners in ((rig.left, pose, left), (rig.right, rig.second(pose), right))
    ]
    return left, exact[0], right, exact[1]


@pytest.mark.parametrize("rig", [PINHOLE, FISHEYE], ids=lambda rig: rig.model)
def test_chessboard(rig: KnownRig) -> None:
    sample = chessboard()
    for pose in poses(3, sample.board_m, rig, seed=4):
        left, exact_left, right, exact_right = found_and_exact(sample, rig, pose)
        # The board may be counted from its other end, in both cameras
        turned = np.abs(left.image_px - exact_left).max() > 5
        for corners, exact in ((left, exact_left), (right, exact_right)):
            order = slice(None, None, -1 if turned else 1)
            assert np.sqrt(np.mean((corners.image_px - exact[order]) ** 2)) < 0.1
        np.testing.assert_allclose(left.board_m, sample.board_m)


@needs_detectors
def test_charuco() -> None:
    sample = charuco()
    for pose in poses(3, sample.board_m, PINHOLE, seed=2):
        left, exact_left, right, exact_right = found_and_exact(sample, PINHOLE, pose)
        for corners, exact in ((left, exact_left), (right, exact_right)):
            np.testing.assert_allclose(corners.board_m, sample.board_m[corners.ids])
            assert len(corners.ids) >= 12
            assert np.sqrt(np.mean((corners.image_px - exact) ** 2)) < 0.15


@needs_detectors
def test_partly_covered_charuco() -> None:
    sample = charuco()
    pose = poses(1, sample.board_m, PINHOLE, seed=2)[0]
    image, _ = photograph(sample.print_, sample.cell_px, sample.cell_m, PINHOLE, pose)
    exact = project(PINHOLE.model, PINHOLE.left, pose, sample.board_m).image_px
    image[:, : round(exact[:, 0].mean()) - 20] = 100
    corners = sample.board.detect(image)
    assert corners is not None
    assert 8 <= len(corners.ids) < len(sample.board_m)
    assert np.sqrt(np.mean((corners.image_px - exact[corners.ids]) ** 2)) < 0.2


@needs_detectors
@pytest.mark.parametrize(("border_bits", "turns"), [(2, 0), (1, 0), (2, 1)])
def test_aprilgrid(border_bits: int, turns: int) -> None:
    """With Kalibr's wide border and the narrow one of others, whichever corner of a tag is its first."""
    sample = aprilgrid(border_bits, turns)
    pose = np.array([2.9, 0.1, 0.2, -0.1, 0.12, 0.5])  # the y axis of the board points up
    left, exact_left, right, exact_right = found_and_exact(sample, PINHOLE, pose)
    for corners, exact in ((left, exact_left), (right, exact_right)):
        assert len(corners.ids) == 48
        np.testing.assert_allclose(corners.board_m, sample.board_m[corners.ids])
        assert np.sqrt(np.mean((corners.image_px - exact) ** 2)) < 0.15


@needs_detectors
@pytest.mark.parametrize("kind", ["chessboard", "charuco", "aprilgrid"])
def test_no_board(kind: str) -> None:
    noise = np.random.default_rng(0).integers(0, 255, SIZE[::-1], np.uint8)
    assert create_board(kind, (7, 5), 0.03).detect(noise) is None


def test_edges_are_as_wide_as_they_are_blurred() -> None:
    """A step blurred by sigma has its contrast over its steepest slope at sqrt(2 pi) sigma."""
    image = np.full((200, 300), 40, np.uint8)
    image[:, 150:] = 200
    corners = Corners(np.arange(6), np.zeros((6, 3)), np.column_stack((np.full(6, 149.5), np.arange(6) * 30.0 + 20)))
    widths = [edge_width_px(np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.uint8), corners) for sigma in (2, 3)]
    # The image is smoothed by 0.7 px, and its slope is computed over three pixels
    assert widths[0] == pytest.approx(np.sqrt(2 * np.pi * (4 + 1.2)), rel=0.1)
    assert widths[1] / widths[0] == pytest.approx(1.45, rel=0.1)


def test_chessboards_are_counted_equally_in_both_cameras() -> None:
    board = create_board("chessboard", (5, 4), 0.03)
    board_m = chessboard_points(5, 4)
    left = Corners(np.arange(20), board_m, board_m[:, :2] * 900 + [100, 80])
    for order in (slice(None), slice(None, None, -1)):
        right = Corners(np.arange(20), board_m, (left.image_px - [30, 2])[order])
        np.testing.assert_allclose(board.align(left, right).image_px, left.image_px - [30, 2])


def test_square_chessboards_are_counted_equally_when_rotated_by_90_degrees() -> None:
    board = create_board("chessboard", (4, 4), 0.03)
    board_m = chessboard_points(4, 4)
    left = Corners(np.arange(16), board_m, board_m[:, :2] * 900 + [100, 80])
    quarter = left.image_px.reshape(4, 4, 2).transpose(1, 0, 2)[::-1].reshape(-1, 2)
    right = Corners(np.arange(16), board_m, quarter - [30, 2])
    np.testing.assert_allclose(board.align(left, right).image_px, left.image_px - [30, 2])


def test_invalid_boards() -> None:
    with pytest.raises(ConfigError, match=r"'circles' is not one of chessboard, charuco, aprilgrid"):
        create_board("circles", (9, 6), 0.025)
    with pytest.raises(ConfigError, match=r"size 9x2 is below 3x3: count the inner corners"):
        create_board("chessboard", (9, 2), 0.025)
    with pytest.raises(ConfigError, match=r"square 25 m is outside .* 25 mm is 0\.025"):
        create_board("chessboard", (9, 6), 25)


@needs_detectors
def test_invalid_marker_boards() -> None:
    with pytest.raises(ConfigError, match=r"marker 0\.05 m is not within 0\.\.0\.03 m"):
        create_board("charuco", (7, 5), 0.03, marker_m=0.05)
    with pytest.raises(ConfigError, match=r"'DICT_9X9' is not one of .*DICT_4X4_50"):
        create_board("charuco", (7, 5), 0.03, dictionary="DICT_9X9")
    with pytest.raises(ConfigError, match=r"DICT_4X4_50 has 50 markers, 12x10 squares have 60: use the dictionary"):
        create_board("charuco", (12, 10), 0.03)
    with pytest.raises(ConfigError, match=r"spacing 3 is outside 0\.\.2"):
        create_board("aprilgrid", (6, 6), 0.08, spacing=3)
    with pytest.raises(ConfigError, match=r"30x20 tags are more than the 587"):
        create_board("aprilgrid", (30, 20), 0.08)


def test_without_detectors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "aruco", raising=False)
    with pytest.raises(ConfigError, match=r"no marker detectors, which were added in 4\.7: install"):
        create_board("aprilgrid", (6, 6), 0.08)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Targets on a turntable: single ArUco markers of one size, or a board."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from stereo_depth_ros.active.light_stripe.turntable import Target
from stereo_depth_ros.calibration.boards import Board, Corners, check_board_size, refine_corners
from stereo_depth_ros.calibration.marker_boards import marker_detector
from stereo_depth_ros.core.types import U8

__all__ = ["BoardTarget", "MarkerTargets", "TargetFinder"]


class TargetFinder(Protocol):
    """Finds targets in images."""

    def find(self, gray: U8) -> dict[int, Target]:
        """The targets in an image, uint8 (H, W), by their numbers; empty where there are none."""


class MarkerTargets:
    """Single markers, each with its own number.

    Args:
        marker_m: side of a marker, meters.
        dictionary: OpenCV name, such as "DICT_4X4_50".

    Raises:
        ConfigError: a side out of range, an unknown name, or an OpenCV before 4.7.
    """

    def __init__(self, marker_m: float, dictionary: str) -> None:
        check_board_size((3, 3), marker_m, 3, "markers")
        self._detector = marker_detector(dictionary)
        half = marker_m / 2
        self._board_m = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])

    def find(self, gray: U8) -> dict[int, Target]:
        """The markers that are seen once."""
        quads, ids, _ = self._detector.detectMarkers(gray)
        if ids is None:
            return {}
        numbers = np.asarray(ids).ravel()
        found = {}
        for number, quad in zip(numbers, quads, strict=True):
            if np.count_nonzero(numbers == number) == 1:
                corners = np.asarray(quad, np.float64).reshape(4, 2)
                spacing = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).min())
                found[int(number)] = Target(np.arange(4), self._board_m, refine_corners(gray, corners, spacing))
        return found


class BoardTarget:
    """A board on the table. The first corner of a chessboard is ambiguous: it turns by less than 90 degrees a view.

    Args:
        board: the board.
    """

    def __init__(self, board: Board) -> None:
        self._board = board
        self._last: Corners | None = None

    def find(self, gray: U8) -> dict[int, Target]:
        """The board as target 0."""
        corners = self._board.detect(gray)
        if corners is None:
            return {}
        if self._last is not None:
            corners = self._board.align(self._last, corners)
        self._last = corners
        return {0: Target(corners.ids, corners.board_m, corners.image_px)}

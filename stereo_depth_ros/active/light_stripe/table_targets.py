# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Targets on a turntable: single ArUco markers of one size, or a board."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np

from stereo_depth_ros.active.light_stripe.turntable import Target
from stereo_depth_ros.calibration.boards import Board, Corners, check_board_size
from stereo_depth_ros.calibration.marker_boards import marker_detector
from stereo_depth_ros.core.types import F64, U8

__all__ = ["BoardTarget", "MarkerTargets", "TargetFinder", "refine_square"]

_SAMPLES = 24  # profiles across each side
_MARGIN = 0.12  # of the side at either end, where the other sides are near
_REACH = 1 / 9  # of the side: profiles end within the black border, a sixth of the side
_STEP_PX = 0.25


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
                found[int(number)] = Target(np.arange(4), self._board_m, refine_square(gray, corners))
        return found


def refine_square(gray: U8, corners_px: F64) -> F64:
    """Sub-pixel corners of a black square on white: intersections of lines through the places of half its contrast.

    Methods for corners between four squares, such as cornerSubPix, place those of a single square up to 0.2 px too far
    inside where the image is blurred.

    Args:
        gray: uint8 (H, W).
        corners_px: float64 (4, 2), in order around the square, within a pixel or two.

    Returns:
        float64 (4, 2); a corner whose sides are not found stays.
    """
    lines = [_side(gray, corners_px[k], corners_px[(k + 1) % 4], corners_px.mean(axis=0)) for k in range(4)]
    refined = corners_px.copy()
    for k in range(4):
        before, after = lines[k - 1], lines[k]
        if before is None or after is None:
            continue
        x, y, w = np.cross(before, after)
        if w and np.hypot(x / w - corners_px[k, 0], y / w - corners_px[k, 1]) < 3:
            refined[k] = x / w, y / w
    return refined


def _side(gray: U8, first: F64, last: F64, center: F64) -> F64 | None:
    """The line of a side, homogeneous float64 (3,); None where too few profiles cross it."""
    length = float(np.linalg.norm(last - first))
    outward = np.array([last[1] - first[1], first[0] - last[0]]) / length
    outward = -outward if outward @ (first - center) < 0 else outward
    reach = float(np.clip(_REACH * length, 1.5, 6.0))
    offsets = np.arange(-reach, reach + _STEP_PX / 2, _STEP_PX)
    along = np.linspace(_MARGIN, 1 - _MARGIN, _SAMPLES)[:, None]
    starts = first + along * (last - first)
    places = starts[:, None] + offsets[:, None] * outward
    levels = cv2.remap(gray, places.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profiles = np.asarray(levels, np.float64).reshape(_SAMPLES, len(offsets))
    dark, bright = profiles[:, :2].mean(axis=1), profiles[:, -2:].mean(axis=1)
    half = (dark + bright) / 2
    below = profiles < half[:, None]
    at = below.shape[1] - 1 - below[:, ::-1].argmax(axis=1)  # the last place inside
    usable = (bright - dark > 20) & below.any(axis=1) & (at < len(offsets) - 1)
    if np.count_nonzero(usable) < _SAMPLES // 3:
        return None
    rows, at = np.flatnonzero(usable), at[usable]
    low, high = profiles[rows, at], profiles[rows, at + 1]
    crossing = offsets[at] + _STEP_PX * (half[rows] - low) / (high - low)
    kept = np.abs(crossing - np.median(crossing)) < 1.0
    points = (starts[rows] + crossing[:, None] * outward)[kept]
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][1]
    return np.array([*normal, -normal @ middle])


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

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Chessboards: detection, and the same corner order in both cameras."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from stereo_depth_ros.calibration.boards import Corners, check_board_size, refine_corners
from stereo_depth_ros.core.types import F64, U8

__all__ = ["Chessboard"]


class Chessboard:
    """A chessboard; all of it must be in the image.

    Args:
        size: columns, rows of inner corners.
        square_m: side of a square, meters.

    Raises:
        ConfigError: a size or a square out of range.
    """

    counted = "inner corners"

    def __init__(self, size: tuple[int, int], square_m: float) -> None:
        check_board_size(size, square_m, 3, self.counted)
        self.size = size
        columns, rows = size
        self._ids = np.arange(columns * rows)
        grid = np.column_stack([self._ids % columns, self._ids // columns, 0 * self._ids])
        self._board_m = square_m * grid.astype(np.float64)

    def detect(self, gray: U8) -> Corners | None:
        """All corners, or None."""
        found, corners = cv2.findChessboardCorners(
            gray, self.size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        )
        if not found:  # slower, but detects blurred and strongly distorted boards
            found, corners = cv2.findChessboardCornersSB(gray, self.size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not found:
            return None
        corners_px = np.asarray(corners, np.float64).reshape(-1, 2)
        if (corners_px < 0).any() or (corners_px > np.array(gray.shape[::-1]) - 1).any():
            return None  # extrapolated, as where a board of another size is sought
        refined = refine_corners(gray, corners_px, self._spacing_px(corners_px))
        return Corners(self._ids, self._board_m, refined)

    def align(self, left: Corners, right: Corners) -> Corners:
        """The right corners in the order of the left ones.

        The first corner of a chessboard is ambiguous. Of the possible orders, the one most similar to the left corners
        is used, which requires a relative roll of the cameras below 90 degrees, or 45 degrees for a square board.
        """
        expected = left.image_px - left.image_px.mean(axis=0)

        def difference(corners_px: F64) -> float:
            return float(np.square(corners_px - corners_px.mean(axis=0) - expected).sum())

        return Corners(right.ids, right.board_m, min(self._orders(right.image_px), key=difference))

    def _orders(self, corners_px: F64) -> Iterator[F64]:
        """The orders of the corners that give a board of this size."""
        columns, rows = self.size
        grid = corners_px.reshape(rows, columns, 2)
        grids = (grid, grid.transpose(1, 0, 2)) if rows == columns else (grid,)
        for each in grids:
            for down in (1, -1):
                for across in (1, -1):
                    yield each[::down, ::across].reshape(-1, 2)

    def _spacing_px(self, corners_px: F64) -> float:
        grid = corners_px.reshape(self.size[1], self.size[0], 2)
        return float(min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)))

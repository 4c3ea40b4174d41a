# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration boards: the interface, and sub-pixel refinement and sharpness of their corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F64, U8

__all__ = [
    "Board",
    "Corners",
    "check_board_size",
    "edge_width_px",
    "is_sharp",
    "refine_corners",
    "spacing_px",
]

MIN_SQUARE_M, MAX_SQUARE_M = 1e-3, 1.0
MIN_CORNERS = 8  # 16 coordinates determine the 6 of the pose and leave 10 for the cameras
_MAX_HALF_WINDOW = 5  # px
# Largest edge width of a sharp image: share of the corner spacing, within px limits; the upper one grows with the width
_SPACING_SHARE, _LEAST_LIMIT_PX, _LARGEST_LIMIT_PX, _WIDTH_SHARE = 0.3, 3.9, 5.0, 0.005


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of a board detected in one image.

    Attributes:
        ids: int (N,), numbers of the corners on the board, unique.
        board_m: float64 (N, 3), positions on the board, meters, z = 0.
        image_px: float64 (N, 2), positions in the image, columns x, y, px.
    """

    ids: npt.NDArray[np.int64]
    board_m: F64
    image_px: F64


class Board(Protocol):
    """A board that can be detected in images.

    Attributes:
        size: columns, rows, as the user counts them.
        counted: name of what ``size`` counts.
    """

    size: tuple[int, int]
    counted: str

    def detect(self, gray: U8) -> Corners | None:
        """Corners in an image, uint8 (H, W); None where the board is not found."""

    def align(self, left: Corners, right: Corners) -> Corners:
        """The right corners in the order of the left ones, where the orientation of the board is ambiguous."""


def check_board_size(size: tuple[int, int], square_m: float, smallest: int, counted: str) -> None:
    """Check the size of a board and of its squares.

    Raises:
        ConfigError: fewer than ``smallest`` columns or rows, or a square that is not 1 mm to 1 m.
    """
    if min(size) < smallest:
        raise ConfigError(
            f"size {size[0]}x{size[1]} is below {smallest}x{smallest}",
            value=size,
            limit=smallest,
            remedy=f"count the {counted}, columns x rows, such as 9x6",
            settings=("size",),
        )
    if not MIN_SQUARE_M <= square_m <= MAX_SQUARE_M:
        raise ConfigError(
            f"square {square_m:g} m is outside {MIN_SQUARE_M:g}..{MAX_SQUARE_M:g} m",
            value=square_m,
            limit=(MIN_SQUARE_M, MAX_SQUARE_M),
            remedy=f"enter meters: {square_m:g} mm is {square_m / 1000:g}",
            settings=("square",),
        )


def is_sharp(gray: U8, corners: Corners) -> bool:
    """Whether the edges at the corners are sharp enough for exact positions; smaller squares need sharper edges."""
    largest_px = max(_LARGEST_LIMIT_PX, _WIDTH_SHARE * gray.shape[1])
    limit_px = np.clip(_SPACING_SHARE * spacing_px(corners), _LEAST_LIMIT_PX, largest_px)
    return bool(edge_width_px(gray, corners) <= limit_px)


def edge_width_px(gray: U8, corners: Corners) -> float:
    """Median width of the edges at the corners, px: contrast over the steepest slope around each corner.

    Two sets of sharp 640x480 images have 2.4 to 3.7 px, the same images blurred by a Gaussian of 2 px have 5.2 px and
    more.
    """
    half = int(np.clip(spacing_px(corners) / 3, 3, 12))
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), 0.7)
    slope = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)) / 8
    widths = []
    for x, y in np.rint(corners.image_px).astype(int):
        around = slice(max(0, y - half), y + half + 1), slice(max(0, x - half), x + half + 1)
        dark, bright = np.percentile(smooth[around], (5, 95))
        widths.append((bright - dark) / max(float(np.percentile(slope[around], 95)), 1e-6))
    return float(np.median(widths))


def spacing_px(corners: Corners) -> float:
    """Median distance of a corner from the nearest other one."""
    distances = np.linalg.norm(corners.image_px[:, None] - corners.image_px[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    return float(np.median(distances.min(axis=1)))


def refine_corners(gray: U8, corners_px: F64, spacing_px: float) -> F64:
    """Sub-pixel corners from the gradients around each corner (Foerstner 1987, OpenCV's cornerSubPix).

    Args:
        gray: uint8 (H, W).
        corners_px: float64 (N, 2), within a pixel or two.
        spacing_px: smallest distance between two corners, px; limits the window to exclude neighboring corners.
    """
    half = int(np.clip(spacing_px / 3, 1, _MAX_HALF_WINDOW))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    points: Any = np.ascontiguousarray(corners_px, np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(gray, points.copy(), (half, half), (-1, -1), criteria)
    return np.asarray(refined, np.float64).reshape(-1, 2)

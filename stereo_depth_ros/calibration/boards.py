# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all calibration boards share: the corners seen of one, their refinement, and the sharpness of an image."""

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
]

MIN_SQUARE_M, MAX_SQUARE_M = 1e-3, 1.0
MIN_CORNERS = 8  # 8 points fix the pose of a view (6 numbers) and leave 10 measurements for the rest
_MAX_HALF_WINDOW = 5  # px
# Width of edges up to which an image is sharp: as a share of the squares, at least and at most, px, and of the width
_SOFT_OF_SPACING, _SHARP_PX, _SOFT_PX, _SOFT_SHARE = 0.3, 3.9, 5.0, 0.005


@dataclass(frozen=True, eq=False)
class Corners:
    """What was seen of a board in one image.

    Attributes:
        ids: int (N,), numbers of the corners on the board, unique.
        board_m: float64 (N, 3), where they are on the board, meters, z = 0.
        image_px: float64 (N, 2), where they are in the image, columns x, y, px.
    """

    ids: npt.NDArray[np.int64]
    board_m: F64
    image_px: F64


class Board(Protocol):
    """A board that can be found in images.

    Attributes:
        size: columns, rows, as the user counts them.
        counted: what ``size`` counts.
    """

    size: tuple[int, int]
    counted: str

    def detect(self, gray: U8) -> Corners | None:
        """The corners in an image, uint8 (H, W); None where the board is not found."""

    def align(self, left: Corners, right: Corners) -> Corners:
        """The right corners in the order of the left ones, where the board itself does not tell its orientation."""


def check_board_size(size: tuple[int, int], square_m: float, smallest: int, counted: str) -> None:
    """Refuses boards that cannot be.

    Raises:
        ConfigError: fewer than ``smallest`` columns or rows, or a square that is not 1 mm to 1 m.
    """
    if min(size) < smallest:
        raise ConfigError(
            f"size {size[0]}x{size[1]} is below {smallest}x{smallest}: count the {counted}, columns x rows, such as 9x6"
        )
    if not MIN_SQUARE_M <= square_m <= MAX_SQUARE_M:
        raise ConfigError(
            f"square {square_m:g} m is outside {MIN_SQUARE_M:g}..{MAX_SQUARE_M:g} m: it is given in meters, "
            f"{square_m:g} mm are {square_m / 1000:g}"
        )


def is_sharp(gray: U8, corners: Corners) -> bool:
    """Whether the edges at the corners are steep enough for exact positions; the smaller the squares, the steeper."""
    finest_px, coarsest_px = _SHARP_PX, max(_SOFT_PX, _SOFT_SHARE * gray.shape[1])
    limit_px = np.clip(_SOFT_OF_SPACING * _spacing_px(corners), finest_px, coarsest_px)
    return bool(edge_width_px(gray, corners) <= limit_px)


def edge_width_px(gray: U8, corners: Corners) -> float:
    """How many pixels the edges at the corners take from dark to bright, their median; many in blurred images.

    Contrast over the steepest slope, around each corner. Two sets of sharp 640x480 images have 2.4 to 3.7 px, the
    same images blurred by a Gaussian of 2 px have 5.2 px and more.
    """
    half = int(np.clip(_spacing_px(corners) / 3, 3, 12))
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), 0.7)
    slope = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)) / 8
    widths = []
    for x, y in np.rint(corners.image_px).astype(int):
        around = slice(max(0, y - half), y + half + 1), slice(max(0, x - half), x + half + 1)
        dark, bright = np.percentile(smooth[around], (5, 95))
        widths.append((bright - dark) / max(float(np.percentile(slope[around], 95)), 1e-6))
    return float(np.median(widths))


def _spacing_px(corners: Corners) -> float:
    """Median distance of a corner from the nearest other one."""
    distances = np.linalg.norm(corners.image_px[:, None] - corners.image_px[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    return float(np.median(distances.min(axis=1)))


def refine_corners(gray: U8, corners_px: F64, spacing_px: float) -> F64:
    """Corners to a small part of a pixel, by the gradients around each (Foerstner 1987, OpenCV's cornerSubPix).

    Args:
        gray: uint8 (H, W).
        corners_px: float64 (N, 2), within a pixel or two.
        spacing_px: smallest distance of two corners, px; the window keeps clear of the neighbors.
    """
    half = int(np.clip(spacing_px / 3, 1, _MAX_HALF_WINDOW))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    points: Any = np.ascontiguousarray(corners_px, np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(gray, points.copy(), (half, half), (-1, -1), criteria)
    return np.asarray(refined, np.float64).reshape(-1, 2)

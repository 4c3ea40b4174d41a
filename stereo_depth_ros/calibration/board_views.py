# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views of a board by both cameras: placement in the image, coverage of all views, and advice on missing views."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.lens_circle import LensCircle
from stereo_depth_ros.core.types import F64

__all__ = ["BoardView", "Coverage", "Placement", "ViewCollector", "placement"]

# Full coverage, and the distance of a new view from all others, as in camera_calibration of ROS
_FULL = {"x": 0.7, "y": 0.7, "size": 0.4, "skew": 0.5}
_MIN_DISTANCE = 0.2
_EDGE = 0.15  # from 0 or 1, within which a position counts as at that end


@dataclass(frozen=True, eq=False)
class BoardView:
    """A board detected by both cameras.

    Attributes:
        name: of the pair, for messages: a file, or a stamp.
        size: width, height of both images, px.
        left, right: corners of the board, in the same order where the board does not number them.
    """

    name: str
    size: tuple[int, int]
    left: Corners
    right: Corners


class Placement(NamedTuple):
    """Placement of a board in an image, each value within 0..1.

    Attributes:
        x, y: position, 0 where the board touches the left or upper edge, 1 where it touches the right or lower one.
        size: square root of the board's share of the image area.
        skew: difference of the angle at a corner of the board from a right angle; 1 is 30 degrees or more.
    """

    x: float
    y: float
    size: float
    skew: float


def placement(corners: Corners, size: tuple[int, int], circle: LensCircle | None = None) -> Placement:
    """Placement of a board in an image of ``size`` (width, height), as camera_calibration of ROS measures it.

    With the image circle of the lens, the placement in what the circle leaves of the image.
    """
    points = corners.image_px
    area = cv2.contourArea(cv2.convexHull(points.astype(np.float32)))
    border = float(np.sqrt(area))
    x0, y0, width, height = circle.box(size) if circle is not None else (0.0, 0.0, *map(float, size))
    x, y = (
        float(np.clip((mean - start - border / 2) / max(length - border, 1.0), 0, 1))
        for mean, start, length in zip(points.mean(axis=0), (x0, y0), (width, height), strict=True)
    )
    return Placement(x, y, min(1.0, border / float(np.sqrt(width * height))), _skew(corners))


def _skew(corners: Corners) -> float:
    """Skew from the angle between a row and a column of the board, at the corner where they meet."""
    board = corners.board_m[:, :2]
    origin, across, down = (
        corners.image_px[int(np.argmin(board @ direction))]
        for direction in (np.array([1.0, 1.0]), np.array([-1.0, 1.0]), np.array([1.0, -1.0]))
    )
    one, other = across - origin, down - origin
    length = float(np.linalg.norm(one) * np.linalg.norm(other))
    if length == 0:
        return 0.0
    angle = np.arccos(np.clip(one @ other / length, -1, 1))
    return float(min(1.0, 2 * abs(np.pi / 2 - angle)))


@dataclass(frozen=True)
class Coverage:
    """Coverage of the image by views.

    Attributes:
        x, y, size, skew: 0..1, 1 is sufficient for a calibration.
        missing: what to show next, a sentence each; empty where the coverage is complete.
    """

    x: float
    y: float
    size: float
    skew: float
    missing: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Nothing is missing."""
        return not self.missing

    @classmethod
    def of(cls, placements: Sequence[Placement]) -> Coverage:
        """Coverage by placements in the left images; size and skew count from 0."""
        if not placements:
            return cls(0.0, 0.0, 0.0, 0.0, ("show the board to both cameras",))
        values: F64 = np.array(placements, np.float64)
        low, high = values.min(axis=0), values.max(axis=0)
        low[2:] = 0
        reached = np.minimum((high - low) / np.array(list(_FULL.values())), 1.0)
        missing = [*_missing_position(low[0], high[0], reached[0], ("left", "right"))]
        missing += _missing_position(low[1], high[1], reached[1], ("upper", "lower"))
        if reached[2] < 1:
            missing.append("move the board closer, until it fills half of the image's width and height")
        if reached[3] < 1:
            missing.append("tilt the board, one edge nearer to the cameras than the other, and turn it in its plane")
        x, y, size, skew = (float(value) for value in reached)
        return cls(x, y, size, skew, tuple(missing))


def _missing_position(low: float, high: float, reached: float, edges: tuple[str, str]) -> Iterable[str]:
    if reached >= 1:
        return
    if low > _EDGE:
        yield f"move the board to the {edges[0]} edge"
    if high < 1 - _EDGE:
        yield f"move the board to the {edges[1]} edge"


class ViewCollector:
    """Collects views that differ from those collected before.

    Attributes:
        views: collected so far.
        circle: image circle of the left lens, within which the coverage is judged; None is the whole image.
    """

    def __init__(self) -> None:
        self.views: list[BoardView] = []
        self.circle: LensCircle | None = None
        self._placements: list[Placement] = []

    def is_new(self, left: Corners, size: tuple[int, int]) -> bool:
        """Whether the placement in the left image differs from those of all views."""
        place = np.array(placement(left, size))
        return all(float(np.abs(place - other).sum()) > _MIN_DISTANCE for other in np.array(self._placements))

    def add(self, view: BoardView) -> bool:
        """Add the view if it is new; return whether it was added."""
        if not self.is_new(view.left, view.size):
            return False
        self.views.append(view)
        self._placements.append(placement(view.left, view.size))
        return True

    @property
    def coverage(self) -> Coverage:
        """Coverage of the views collected so far."""
        if self.circle is None:
            return Coverage.of(self._placements)
        return Coverage.of([placement(view.left, view.size, self.circle) for view in self.views])

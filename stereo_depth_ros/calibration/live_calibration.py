# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Live calibration: collects views of a board from image pairs, advises on missing views, and calibrates."""

from __future__ import annotations

import enum

import numpy as np

from stereo_depth_ros.calibration.board_views import BoardView, Coverage, ViewCollector
from stereo_depth_ros.calibration.boards import Board, Corners, is_sharp
from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.camera_calibration import MIN_VIEWS
from stereo_depth_ros.calibration.distortion_range import Circles
from stereo_depth_ros.calibration.lens_circle import LitPixels
from stereo_depth_ros.calibration.stereo_calibration import calibrate
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import U8

__all__ = ["GOOD_VIEWS", "LiveCalibration", "ViewStatus"]

GOOD_VIEWS = 20  # sufficient for common lenses if they cover the image


class ViewStatus(enum.Enum):
    """Result of adding a pair of images; the value is a message for the operator."""

    ADDED = "taken"
    DUPLICATE = "the board is placed as in a previous view: move or tilt it"
    MOVING = "the board moves: hold it still"
    BLURRED = "the image of the board is blurred: hold it still, focus, or give more light"
    LEFT_ONLY = "the right camera does not see the board: hold it where both cameras see it"
    RIGHT_ONLY = "the left camera does not see the board: hold it where both cameras see it"
    NOT_FOUND = "no board is detected: hold it in front of both cameras, well lit"


class LiveCalibration:
    """Collects views of a board and calibrates with them.

    Args:
        board: to detect.
        model: distortion model of the lenses.
        max_motion_px: largest median corner motion since the previous pair; a moving board is blurred, and at different
            places in cameras that are not synchronized. 0 accepts moving boards.

    Attributes:
        max_motion_px: as given; may be changed.
        result: of the newest calibration; None before the first.
        seen: corners in the left image of the newest pair; None where the board was not detected.
    """

    def __init__(self, board: Board, model: str, max_motion_px: float = 2.0) -> None:
        self._board, self._model, self.max_motion_px = board, model, max_motion_px
        self._collector = ViewCollector()
        self._lit = LitPixels(), LitPixels()
        self._circles: Circles = (None, None)
        self._size: tuple[int, int] | None = None
        self.result: StereoCalibration | None = None
        self.seen: Corners | None = None

    @property
    def views(self) -> list[BoardView]:
        """Views collected so far."""
        return self._collector.views

    @property
    def coverage(self) -> Coverage:
        """Coverage of the views, and what is missing."""
        return self._collector.coverage

    @property
    def advice(self) -> tuple[str, ...]:
        """What to show next, a sentence each; empty where nothing is missing."""
        more = GOOD_VIEWS - len(self.views)
        few = (f"show {more} more views of {GOOD_VIEWS}",) if more > 0 else ()
        return (*self.coverage.missing, *few)

    def add(self, name: str, left: U8, right: U8) -> ViewStatus:
        """Detect the board in a pair, and collect the view if it is new, still and sharp.

        Args:
            name: of the pair, for messages.
            left, right: uint8 (H, W), gray, raw.

        Raises:
            CalibrationError: the image size differs from that of the first pair.
        """
        size = self._checked_size(left, right)
        for pixels, gray in zip(self._lit, (left, right), strict=True):
            pixels.add(gray)
        before, self.seen = self.seen, self._board.detect(left)
        if self.seen is None:
            return ViewStatus.NOT_FOUND if self._board.detect(right) is None else ViewStatus.RIGHT_ONLY
        if self.max_motion_px and _motion_px(before, self.seen) > self.max_motion_px:
            return ViewStatus.MOVING
        if not self._collector.is_new(self.seen, size):
            return ViewStatus.DUPLICATE
        found = self._board.detect(right)
        if found is None:
            return ViewStatus.LEFT_ONLY
        if not (is_sharp(left, self.seen) and is_sharp(right, found)):
            return ViewStatus.BLURRED
        self._collector.add(BoardView(name, size, self.seen, self._board.align(self.seen, found)))
        self._circles = self._lit[0].circle(), self._lit[1].circle()
        self._collector.circle = self._circles[0]
        return ViewStatus.ADDED

    def calibrate(self) -> StereoCalibration:
        """Calibrate with all views collected so far and set :attr:`result`.

        Raises:
            CalibrationError: too few views, or they do not determine the cameras.
        """
        if len(self.views) < MIN_VIEWS:
            raise CalibrationError(
                f"{len(self.views)} views so far, at least {MIN_VIEWS} are needed",
                value=len(self.views),
                limit=MIN_VIEWS,
                remedy="; ".join(self.advice),
            )
        self.result = calibrate(self.views, self._model, self._circles)
        return self.result

    def _checked_size(self, left: U8, right: U8) -> tuple[int, int]:
        size = (left.shape[1], left.shape[0])
        self._size = self._size or size
        for image, side in ((left, "left"), (right, "right")):
            if image.shape[::-1] != self._size:
                raise CalibrationError(
                    f"{image.shape[1]}x{image.shape[0]}, previous images {self._size[0]}x{self._size[1]}, a "
                    "calibration is for one image size",
                    subject=f"{side} image",
                    value=image.shape[::-1],
                    limit=self._size,
                    remedy="restart to calibrate at the new size",
                )
        return size


def _motion_px(before: Corners | None, now: Corners) -> float:
    """Median motion of the corners detected in both images; infinite without any."""
    if before is None:
        return np.inf
    _, old, new = np.intersect1d(before.ids, now.ids, return_indices=True)
    if not len(old):
        return np.inf
    return float(np.median(np.linalg.norm(now.image_px[new] - before.image_px[old], axis=1)))

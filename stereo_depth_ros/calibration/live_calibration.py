# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration while somebody moves a board before the cameras: which views are taken, what is missing, the result."""

from __future__ import annotations

import enum

import numpy as np

from stereo_depth_ros.calibration.board_views import BoardView, Coverage, ViewCollector
from stereo_depth_ros.calibration.boards import Board, Corners, is_sharp
from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.camera_calibration import MIN_VIEWS
from stereo_depth_ros.calibration.stereo_calibration import calibrate
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import U8

__all__ = ["GOOD_VIEWS", "LiveCalibration", "Look"]

GOOD_VIEWS = 20  # as many as make the parameters of common lenses good, when they cover the image


class Look(enum.Enum):
    """What became of a pair of images; the value is what to tell who holds the board."""

    TAKEN = "taken"
    KNOWN = "the board lies as in a view that was taken: move or tilt it"
    MOVING = "the board moves: hold it still"
    BLURRED = "the image of the board is blurred: hold it still, focus, or give more light"
    LEFT_ONLY = "the right camera does not see the board: hold it where both cameras see it"
    RIGHT_ONLY = "the left camera does not see the board: hold it where both cameras see it"
    NOWHERE = "no board is seen: hold it before both cameras, with light on it"


class LiveCalibration:
    """Collects views of a board and calibrates with them.

    Args:
        board: what is shown.
        model: distortion model of the lenses.
        max_motion_px: largest median way of the corners since the pair before; a board that moves is blurred, and not
            at one place in two cameras that are not exposed together. 0 takes views of boards that move, too.

    Attributes:
        max_motion_px: as given; may be changed.
        result: of the newest calibration; None before the first.
        seen: where the board was in the left image of the newest pair; None where it was not found.
    """

    def __init__(self, board: Board, model: str, max_motion_px: float = 2.0) -> None:
        self._board, self._model, self.max_motion_px = board, model, max_motion_px
        self._collector = ViewCollector()
        self._size: tuple[int, int] | None = None
        self.result: StereoCalibration | None = None
        self.seen: Corners | None = None

    @property
    def views(self) -> list[BoardView]:
        """Those taken so far."""
        return self._collector.views

    @property
    def coverage(self) -> Coverage:
        """What they cover, and what is missing."""
        return self._collector.coverage

    @property
    def advice(self) -> tuple[str, ...]:
        """What to do next, a sentence each; empty where nothing is missing."""
        more = GOOD_VIEWS - len(self.views)
        few = (f"show {more} more views of {GOOD_VIEWS}",) if more > 0 else ()
        return (*self.coverage.missing, *few)

    def look(self, name: str, left: U8, right: U8) -> Look:
        """Looks at a pair, and takes it where it shows something new.

        Args:
            name: of the pair, for messages.
            left, right: uint8 (H, W), gray, raw.

        Raises:
            CalibrationError: images of another size than those before.
        """
        size = self._checked_size(left, right)
        before, self.seen = self.seen, self._board.detect(left)
        if self.seen is None:
            return Look.NOWHERE if self._board.detect(right) is None else Look.RIGHT_ONLY
        if self.max_motion_px and _motion_px(before, self.seen) > self.max_motion_px:
            return Look.MOVING
        if not self._collector.is_new(self.seen, size):
            return Look.KNOWN
        found = self._board.detect(right)
        if found is None:
            return Look.LEFT_ONLY
        if not (is_sharp(left, self.seen) and is_sharp(right, found)):
            return Look.BLURRED
        self._collector.add(BoardView(name, size, self.seen, self._board.align(self.seen, found)))
        return Look.TAKEN

    def calibrate(self) -> StereoCalibration:
        """Calibrates with all views taken so far; also sets :attr:`result`.

        Raises:
            CalibrationError: too few views, or they do not determine the cameras.
        """
        if len(self.views) < MIN_VIEWS:
            raise CalibrationError(
                f"{len(self.views)} views so far, at least {MIN_VIEWS} are needed: {'; '.join(self.advice)}"
            )
        self.result = calibrate(self.views, self._model)
        return self.result

    def _checked_size(self, left: U8, right: U8) -> tuple[int, int]:
        size = (left.shape[1], left.shape[0])
        self._size = self._size or size
        for image, side in ((left, "left"), (right, "right")):
            if image.shape[::-1] != self._size:
                raise CalibrationError(
                    f"the {side} image is {image.shape[1]}x{image.shape[0]}, those before were {self._size[0]}x"
                    f"{self._size[1]}: a calibration is for one size in both cameras, restart at the new one"
                )
        return size


def _motion_px(before: Corners | None, now: Corners) -> float:
    """Median way of the corners that both images show; infinite without any."""
    if before is None:
        return np.inf
    _, old, new = np.intersect1d(before.ids, now.ids, return_indices=True)
    if not len(old):
        return np.inf
    return float(np.median(np.linalg.norm(now.image_px[new] - before.image_px[old], axis=1)))

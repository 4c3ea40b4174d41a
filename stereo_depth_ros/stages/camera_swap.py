# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tells from the images whether left and right were swapped: then matches lie behind infinity."""

from __future__ import annotations

import threading
from collections.abc import Callable

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import U8

__all__ = ["CameraSwapDetector"]

_WIDTH = 320  # px, of the small images that are matched
_DISPARITIES = 48  # px of those: nearly a seventh of the width
_WINDOW = 15
_ENOUGH = 0.3  # share of pixels that match smoothly, below which nothing is concluded
_CLEARLY = 2.0  # ratio of the shares; true pairs of a dozen scenes gave 3.6 to 14
_AGAIN = 10  # frames until a pair is looked at again while nothing could be concluded


class CameraSwapDetector:
    """Matches a small copy of a rectified pair both ways; the wrong way finds little that is smooth.

    Args:
        doffs_px: cx_left - cx_right, the disparity of infinity, in pixels.
    """

    def __init__(self, doffs_px: float) -> None:
        self._doffs_px = doffs_px
        self._known = False
        self._frames = 0
        self._turn = threading.Lock()

    def check(self, left: U8, right: U8, exchange: Callable[[], tuple[U8, U8]] | None = None) -> None:
        """Look at a pair, until one has shown that the order is right; what shows nothing passes.

        Args:
            left, right: uint8 (H, W), rectified, as they came in.
            exchange: rectifies the raw images the other way round; without it the rectified ones are exchanged,
                which shows little where the two rectifications differ much.

        Raises:
            ImageError: the cameras are swapped.
        """
        if self._known or left.shape != right.shape:
            return
        with self._turn:  # no pair passes while another is looked at
            if not self._known:
                self._look(left, right, exchange)

    def _look(self, left: U8, right: U8, exchange: Callable[[], tuple[U8, U8]] | None) -> None:
        self._frames += 1
        if self._frames % _AGAIN != 1:
            return
        as_given = _smooth_share(left, right, self._doffs_px)
        swapped = _smooth_share(*(exchange() if exchange else (right, left)), self._doffs_px)
        if swapped > _ENOUGH and swapped > _CLEARLY * as_given:
            self._frames = 0  # the next pair is looked at again
            raise ImageError(
                f"cameras look swapped: {100 * swapped:.0f} % of the pixels match with left and right exchanged, "
                f"{100 * as_given:.0f} % as given: exchange the image topics of left and right"
            )
        self._known = as_given > _ENOUGH and as_given > _CLEARLY * swapped


def _smooth_share(left: U8, right: U8, doffs_px: float) -> float:
    """Share of the pixels that match in front of the cameras with a disparity like their neighbor's, 0..1."""
    scale = min(1.0, _WIDTH / left.shape[1])
    left, right = (cv2.resize(i, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for i in (left, right))
    first = int(np.floor(doffs_px * scale))
    count = _DISPARITIES + 16 * int(np.ceil(max(0, -first) / 16))  # infinity far below 0: what is near lies above it
    begin = max(0, first + count) + _WINDOW // 2
    end = left.shape[1] - _WINDOW // 2 + min(0, first)
    if end - begin < _WINDOW or left.shape[0] <= 2 * _WINDOW:
        return 0.0
    stereo = cv2.StereoBM.create(count, _WINDOW)
    stereo.setMinDisparity(first)
    stereo.setUniquenessRatio(15)
    disparity_x16 = stereo.compute(left, right)[_WINDOW // 2 : -(_WINDOW // 2), begin:end]
    valid = disparity_x16 >= 16 * first
    smooth = valid[:, 1:] & valid[:, :-1] & (np.abs(disparity_x16[:, 1:] - disparity_x16[:, :-1]) <= 16)
    return float(smooth.mean())

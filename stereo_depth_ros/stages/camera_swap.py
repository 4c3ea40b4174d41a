# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of swapped cameras from the images: their matches have disparities below that of infinity."""

from __future__ import annotations

import threading
from collections.abc import Callable

import cv2
import numpy as np

from stereo_depth_ros.core.errors import CameraOrderError
from stereo_depth_ros.core.types import U8

__all__ = ["CameraSwapDetector"]

_WIDTH = 320  # px, of the small images that are matched
_DISPARITIES = 48  # px of those: nearly a seventh of the width
_WINDOW = 15
_ENOUGH = 0.3  # minimum share of smooth matches for a decision
_CLEARLY = 2.0  # minimum ratio of the shares; correct pairs of a dozen scenes have 3.6 to 14


class CameraSwapDetector:
    """Matches a small copy of a rectified pair in both orders; the wrong order has few smooth matches.

    Args:
        doffs_px: cx_left - cx_right, the disparity of infinity, in pixels.
    """

    def __init__(self, doffs_px: float) -> None:
        self._doffs_px = doffs_px
        self._known = False
        self._fault: CameraOrderError | None = None
        self._turn = threading.Lock()

    def check(self, left: U8, right: U8, exchange: Callable[[], tuple[U8, U8]] | None = None) -> None:
        """Check every pair until one confirms the order; undecided ones pass unless an earlier one was swapped.

        Args:
            left, right: uint8 (H, W), rectified, in the given order.
            exchange: rectifies the raw images in the other order; without it the rectified images are exchanged,
                which is unreliable if the two rectifications differ much.

        Raises:
            CameraOrderError: the cameras are swapped.
        """
        if self._known or left.shape != right.shape:
            return
        with self._turn:  # no pair passes while another is checked
            if not self._known:
                self._decide(left, right, exchange)

    def _decide(self, left: U8, right: U8, exchange: Callable[[], tuple[U8, U8]] | None) -> None:
        as_given = _smooth_share(left, right, self._doffs_px)
        swapped = _smooth_share(*(exchange() if exchange else (right, left)), self._doffs_px)
        self._known = as_given > _ENOUGH and as_given > _CLEARLY * swapped
        if swapped > _ENOUGH and swapped > _CLEARLY * as_given:
            self._fault = CameraOrderError(
                f"cameras look swapped: {100 * swapped:.0f} % of the pixels match with left and right exchanged, "
                f"{100 * as_given:.0f} % as given",
                value=swapped,
                limit=max(_ENOUGH, _CLEARLY * as_given),
                remedy="exchange the image topics of left and right",
                settings=("left", "right"),
            )
        if self._fault is not None and not self._known:
            raise self._fault.with_traceback(None)


def _smooth_share(left: U8, right: U8, doffs_px: float) -> float:
    """Share of the pixels with a match in front of the cameras that agrees with the neighbor, 0..1."""
    scale = min(1.0, _WIDTH / left.shape[1])
    left, right = (cv2.resize(i, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for i in (left, right))
    first = int(np.floor(doffs_px * scale))
    count = _DISPARITIES + 16 * int(np.ceil(max(0, -first) / 16))  # with infinity far below 0, near points lie above it
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

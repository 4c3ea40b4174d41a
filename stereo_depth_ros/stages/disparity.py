# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The disparity stage: the configured matcher, then what no camera could have seen is taken out."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.rig import Rig
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching import matcher_from_config
from stereo_depth_ros.stages.camera_swap import CameraSwapDetector
from stereo_depth_ros.stages.depth import reject_behind
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["DisparityStage"]


class DisparityStage:
    """Rectified pair to disparities of one rig, for any number of threads.

    Args:
        config: the matcher and its parameters.
        rig: the cameras; their calibration says where a rectified image has pixels. Without one that tells infinity,
            all disparities searched may be those of points in front.

    Raises:
        ConfigError: the parameters contradict each other.
    """

    def __init__(self, config: MatchingConfig, rig: Rig) -> None:
        self._matcher = matcher_from_config(config)
        self._doffs_px = rig.doffs_px
        self._swap_detector = CameraSwapDetector(rig.doffs_px) if rig.metric else None
        rectifier = Rectifier(rig)
        sources = [_eroded(s, config.correlation_window_size) for s in (rectifier.left_source, rectifier.right_source)]
        self._sources = None if all(source.all() for source in sources) else sources

    def match(self, left: U8, right: U8, exchange: Callable[[], tuple[U8, U8]] | None = None) -> MatchResult:
        """Disparities of a rectified pair, NaN with a reason where there is none.

        Rejected are RANGE, what does not lie in front of the cameras, and BORDER, where the matching window leaves what
        the raw left or right camera saw. What is rejected has no confidence, see :class:`MatchResult`.

        Args:
            left, right: uint8 (H, W).
            exchange: rectifies the raw images the other way round, where they are known; see
                :class:`CameraSwapDetector`.

        Raises:
            ImageError: sizes that differ, images too small for the search, or cameras that are swapped.
        """
        if self._swap_detector is not None:
            self._swap_detector.check(left, right, exchange)
        result = self._matcher.match(left, right)
        reject_behind(result.disparity_px, result.reasons, self._doffs_px)
        if self._sources is not None:
            run_bands(_reject_unseen, len(left), result.disparity_px, result.reasons, *self._sources)
        return result


def _eroded(source: npt.NDArray[np.bool_], window: int) -> U8:
    """uint8 (H, W), 1 where the whole window has a source."""
    eroded: U8 = cv2.erode(source.astype(np.uint8), np.ones((window, window), np.uint8), borderValue=1)
    return eroded


_BORDER = np.uint8(Reason.BORDER)


@compiled("void(int64, int64, float32[:, ::1], uint8[:, ::1], uint8[:, ::1], uint8[:, ::1])")
def _reject_unseen(first: int, last: int, disparity_px: F32, reasons: U8, left_seen: U8, right_seen: U8) -> None:
    border = _BORDER
    width = disparity_px.shape[1]
    for y in range(first, last):
        for x in range(width):
            d = disparity_px[y, x]
            unseen = not left_seen[y, x]
            if not unseen and not np.isnan(d):
                at = x - np.int64(np.rint(d))
                unseen = not 0 <= at < width or not right_seen[y, at]
            if unseen:
                disparity_px[y, x] = np.float32(np.nan)
                reasons[y, x] |= border

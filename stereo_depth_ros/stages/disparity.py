# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The disparity stage: the configured matcher, then what no camera could have seen is taken out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compile_kernels, compiled
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
        rectifier: of the rig; it says where a rectified image has pixels. With a rig that does not say where infinity
            is, all disparities searched may be those of points in front.

    Raises:
        ConfigError: the parameters contradict each other.
    """

    def __init__(self, config: MatchingConfig, rectifier: Rectifier) -> None:
        rig = rectifier.rig
        self._matcher = matcher_from_config(config)
        self._doffs_px = rig.doffs_px
        self._swap_detector = CameraSwapDetector(rig.doffs_px) if rig.metric else None
        seen = rectifier.seen(self._matcher.support_px)
        self._seen = None if all(side.all() for side in seen) else seen
        compile_kernels()

    def match(self, left: U8, right: U8, exchange: Callable[[], tuple[U8, U8]] | None = None) -> MatchResult:
        """Disparities of a rectified pair, NaN with a reason where there is none.

        Rejected are RANGE, what does not lie in front of the cameras, and BORDER, where the support of the matcher
        leaves what the raw left or right camera saw. What is rejected has no confidence, see :class:`MatchResult`.

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
        if self._seen is not None:
            run_bands(_reject_unseen, len(left), result.disparity_px, result.reasons, *self._seen)
        return result


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

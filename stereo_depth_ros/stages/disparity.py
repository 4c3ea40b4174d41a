# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Disparity stage: the configured matcher, and rejection of impossible disparities and unseen pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from queue import LifoQueue

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import core_count, run_bands
from stereo_depth_ros.core.kernels import compile_kernels, compiled
from stereo_depth_ros.core.pair_memory import PairMemory
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching import Matcher, matcher_from_config
from stereo_depth_ros.matching.protocol import Images
from stereo_depth_ros.stages.camera_swap import CameraSwapDetector
from stereo_depth_ros.stages.depth import reject_behind
from stereo_depth_ros.stages.limits import Limits
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["LARGEST_AT_ONCE", "DisparityStage"]

LARGEST_AT_ONCE = 4  # pairs that are matched at the same time, however many cores there are


class DisparityStage:
    """Rectified pair to disparities of one rig, for any number of threads.

    Args:
        config: the matcher and its parameters.
        rectifier: of the rig; it has the valid pixels of the rectified images. With an uncalibrated rig all searched
            disparities are in front of the cameras.

    Attributes:
        at_once: pairs that are matched at the same time, others wait: 1, or one a core if the matcher uses one core.

    Raises:
        ConfigError: the parameters contradict each other.
    """

    def __init__(self, config: MatchingConfig, rectifier: Rectifier) -> None:
        rig = rectifier.rig
        matcher = matcher_from_config(config)
        self.at_once = min(core_count(), LARGEST_AT_ONCE) if matcher.uses_one_core else 1
        # The one used last is taken first: its buffers are allocated and in the cache.
        self._free_matchers: LifoQueue[Matcher] = LifoQueue()
        for other in (matcher_from_config(config) for _ in range(self.at_once - 1)):
            self._free_matchers.put(other)
        self._free_matchers.put(matcher)
        self._memory: PairMemory[Images] = PairMemory(matcher.pair_count, config.temporal_gap_ns)
        self._doffs_px = rig.doffs_px
        self._limits = Limits(config, rig)
        self._swap_detector = CameraSwapDetector(rig.doffs_px) if rig.metric else None
        seen = rectifier.seen(matcher.support_px)
        self._seen = None if all(side.all() for side in seen) else seen
        compile_kernels()

    def earlier(self, left: U8, right: U8, stamp_ns: int) -> tuple[Images, ...]:
        """The pairs before this one that the matcher matches together with it, see :class:`PairMemory`.

        To be called with each pair in order; :meth:`match` may then be called in any order. A stage is of one rig and
        one set of parameters, so that a change of these begins anew.

        Args:
            left, right: uint8 (H, W), rectified; they must not change afterwards.
            stamp_ns: of the left image, nanoseconds.
        """
        return self._memory.add((left, right), stamp_ns, left.shape)

    def match(
        self,
        left: U8,
        right: U8,
        exchange: Callable[[], tuple[U8, U8]] | None = None,
        earlier: Sequence[Images] = (),
        prior: DisparityPrior | None = None,
    ) -> MatchResult:
        """Disparities of a rectified pair, NaN with a reason if invalid.

        Rejected are pixels not in front of the cameras (RANGE), those where the support of the matcher leaves the
        valid pixels of the left or right image (BORDER), and those beyond the :class:`Limits`. They have confidence 0,
        see :class:`MatchResult`.

        Args:
            left, right: uint8 (H, W).
            exchange: rectifies the raw images in the other order, see :class:`CameraSwapDetector`.
            earlier: the pairs before this one, of :meth:`earlier`.
            prior: disparities that another sensor expects in the left image.

        Raises:
            ConfigError: a prior, which the matcher does not take.
            ImageError: different sizes, or images too small for the search range.
            CameraOrderError: swapped cameras.
        """
        if self._swap_detector is not None:
            self._swap_detector.check(left, right, exchange)
        matcher = self._free_matchers.get()
        try:
            result = matcher.match(left, right, earlier=earlier, prior=prior)
        finally:
            self._free_matchers.put(matcher)
        reject_behind(result.disparity_px, result.reasons, self._doffs_px)
        if self._seen is not None:
            run_bands(_reject_unseen, len(left), result.disparity_px, result.reasons, *self._seen)
        return self._limits(result)


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

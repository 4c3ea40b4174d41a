# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Space-time stereo: correlation over windows in space and time."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.types import U8, MatchResult
from stereo_depth_ros.matching.filters.speckle_filter import SpeckleFilter
from stereo_depth_ros.matching.local_consistency import local_consistency
from stereo_depth_ros.matching.protocol import Images, check_pair
from stereo_depth_ros.matching.serial import SerialMatcher
from stereo_depth_ros.matching.spacetime.correlation import (
    LARGEST_WINDOW,
    SPECKLE_STEPS_PER_PX,
    STEPS_PER_PX,
    WindowOutput,
    WindowSearch,
    match_rows,
)
from stereo_depth_ros.matching.spacetime.slanted_windows import slant_rows

__all__ = ["SpaceTimeMatcher"]

DEFAULT_PAIRS = 8
_NAN = np.float32(np.nan)


class SpaceTimeMatcher(SerialMatcher):
    """Windows of ``spacetime_window`` squared pixels and ``temporal_window`` pairs (Zhang et al. 2003).

    The scene is lit by a light that changes from pair to pair: projected stripes, noise, or a moving shadow. A pixel
    is then described by its gray levels over time, and windows of 1 x 1 pixel are enough with many pairs; the fewer
    pairs there are, the larger they must be. (Zhang, Curless and Seitz, "Spacetime stereo: shape recovery for dynamic
    scenes", CVPR 2003; Davis, Nehab, Ramamoorthi and Rusinkiewicz, "Spacetime stereo: a unifying framework for depth
    from triangulation", CVPR 2003.)

    The matching cost is 1 - rho, with rho the zero-mean normalized correlation of the two windows over x, y and t, see
    :mod:`~stereo_depth_ros.matching.spacetime.correlation`: gain and offset of the cameras do not matter. The sub-pixel
    part is where rho has its maximum if the right image is cubic between pixels. The images are extended by their
    border pixels.

    Invalid are pixels whose window has no texture in space and time (TEXTURE), whose rho is below 0.5 (NO_MATCH), whose
    second cost is less than ``uniqueness_ratio`` percent above the best (UNIQUENESS), whose right pixel prefers another
    left pixel (LEFT_RIGHT, 1 px unless ``disp12_max_diff`` is larger), and speckles (SPECKLE, ``speckle_range`` in px).
    The confidence is (second - best) / second times the local consistency, computed on demand.

    With ``slanted_windows`` the disparity is linear within the window, for slanted surfaces and moving scenes, see
    :mod:`~stereo_depth_ros.matching.spacetime.slanted_windows`; the result is that of the newest pair.

    ``support_px`` is the window.
    """

    name = "spacetime"
    step_px = 1 / STEPS_PER_PX

    @property
    def support_px(self) -> tuple[int, int]:
        """The window."""
        return self.config.spacetime_window, self.config.spacetime_window

    def __init__(self, config: MatchingConfig) -> None:
        """Raise ConfigError for a window whose sums do not fit in 32 bits."""
        super().__init__(config)
        self.pair_count = config.temporal_window or DEFAULT_PAIRS
        side = config.spacetime_window
        if self.pair_count * side**2 > LARGEST_WINDOW:
            raise ConfigError(
                f"a window of {side} x {side} pixels in {self.pair_count} pairs has more than {LARGEST_WINDOW} samples",
                value=self.pair_count * side**2,
                limit=LARGEST_WINDOW,
                remedy="use a smaller window or fewer pairs",
                settings=("spacetime_window", "temporal_window"),
            )
        self._speckle_filter = SpeckleFilter(config.speckle_size, config.speckle_range * SPECKLE_STEPS_PER_PX)
        self._search = WindowSearch(
            half=side // 2,
            max_disparity=config.max_disparity,
            uniqueness=config.uniqueness_ratio / 100,
            tolerance=max(config.disp12_max_diff, 1),
            ramp=np.arange(config.num_disparities, dtype=np.uint32),
        )

    def _match(self, left: U8, right: U8) -> MatchResult:
        return self._match_pairs([(left, right)], None)

    def _match_pairs(self, pairs: Sequence[Images], prior: DisparityPrior | None) -> MatchResult:
        shape = pairs[-1][0].shape
        check_pair(*pairs[-1], self, partial=True)
        left, right = (self._extended([pair[side] for pair in pairs]) for side in (0, 1))
        disparity_px, margin = np.empty(shape, np.float32), np.empty(shape, np.float32)
        coarse, reasons = np.zeros(shape, np.int16), np.empty(shape, np.uint8)
        output = WindowOutput(disparity_px, coarse, reasons, margin)
        run_bands(match_rows, shape[0], left, right, self._search, output, min_rows=max(64, self._search.half))
        self._speckle_filter(coarse, reasons)
        if self.config.slanted_windows:
            search_px = (self.config.min_disparity, self.config.max_disparity)
            run_bands(slant_rows, shape[0], left, right, self._search.half, *search_px, disparity_px, reasons)
        invalid = reasons != 0
        disparity_px[invalid], margin[invalid] = _NAN, 0
        return MatchResult(
            disparity_px, reasons, self.step_px, functools.partial(local_consistency, disparity_px, margin)
        )

    def _extended(self, images: Sequence[U8]) -> U8:
        """uint8 (pairs, H + 2 half, W + 2 half): extended by the border pixels."""
        half = self._search.half
        return np.stack([cv2.copyMakeBorder(image, *(half,) * 4, cv2.BORDER_REPLICATE) for image in images])

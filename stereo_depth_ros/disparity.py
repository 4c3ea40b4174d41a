# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The disparity stage: the configured matcher, then what cannot lie in front of the cameras is taken out."""

from __future__ import annotations

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.depth import reject_behind
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.stereo_rig import StereoRig
from stereo_depth_ros.types import U8, MatchResult

__all__ = ["DisparityStage"]


class DisparityStage:
    """Rectified pair to disparities of one rig.

    Args:
        config: the matcher and its parameters.
        rig: the rectified cameras.

    Raises:
        ConfigError: the parameters contradict each other.
    """

    def __init__(self, config: MatchingConfig, rig: StereoRig) -> None:
        self._matcher = create_matcher(config.stereo_algorithm, config)
        self._doffs_px = rig.doffs_px

    def match(self, left: U8, right: U8) -> MatchResult:
        """Disparities of rectified uint8 (H, W) images, NaN with a reason where there is none.

        Raises:
            ImageError: sizes that differ, or too small for the search.
        """
        result = self._matcher.match(left, right)
        reject_behind(result.disparity_px, result.reasons, self._doffs_px)
        return result

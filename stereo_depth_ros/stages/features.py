# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The feature stage: matched features of a rectified pair, less what no camera could have seen."""

from __future__ import annotations

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.features.matcher import FeatureMatcher, FeatureMatches
from stereo_depth_ros.stages.camera_swap import CameraSwapDetector
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["FeatureStage"]


class FeatureStage:
    """Rectified pair to matched features of one rig; the sparse counterpart of DisparityStage, for threads as well.

    Args:
        config: the features and the search.
        rectifier: of the rig; it says where a rectified image has pixels.

    Raises:
        ConfigError: the parameters contradict each other.
    """

    def __init__(self, config: MatchingConfig, rectifier: Rectifier) -> None:
        self._matcher = FeatureMatcher(config)
        self._doffs_px = rectifier.rig.doffs_px
        self._swap_detector = CameraSwapDetector(self._doffs_px)
        # The edge of what the raw cameras saw is a line in both images, but nothing in the world.
        self._left_seen, self._right_seen = rectifier.seen(self._matcher.support_px)

    def find(self, left: U8, right: U8) -> FeatureMatches:
        """What both raw cameras saw, in front of them.

        Args:
            left, right: uint8 (H, W), rectified.

        Raises:
            ImageError: sizes that differ, images too small for the search, or cameras that are swapped.
        """
        self._swap_detector.check(left, right)
        matches = self._matcher.find(left, right).inside(self._left_seen, self._right_seen)
        return matches.take(matches.disparity_px > self._doffs_px)

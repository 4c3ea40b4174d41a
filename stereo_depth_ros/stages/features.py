# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Feature stage: matched features of a rectified pair, without impossible ones and unseen pixels."""

from __future__ import annotations

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.features.matcher import FeatureMatcher, FeatureMatches
from stereo_depth_ros.stages.camera_swap import CameraSwapDetector
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["FeatureStage"]


class FeatureStage:
    """Rectified pair to matched features of one rig, for any number of threads; the sparse DisparityStage.

    Args:
        config: the features and the search range.
        rectifier: of the rig; it has the valid pixels of the rectified images.

    Raises:
        ConfigError: the parameters contradict each other.
    """

    def __init__(self, config: MatchingConfig, rectifier: Rectifier) -> None:
        self._matcher = FeatureMatcher(config)
        self._doffs_px = rectifier.rig.doffs_px
        self._swap_detector = CameraSwapDetector(self._doffs_px)
        # The border of the valid pixels is an edge in both images, but not in the scene.
        self._left_seen, self._right_seen = rectifier.seen(self._matcher.support_px)

    def find(self, left: U8, right: U8) -> FeatureMatches:
        """Matches of valid pixels of both images, in front of the cameras.

        Args:
            left, right: uint8 (H, W), rectified.

        Raises:
            ImageError: different sizes, or images too small for the search range.
            CameraOrderError: swapped cameras.
        """
        self._swap_detector.check(left, right)
        matches = self._matcher.find(left, right).inside(self._left_seen, self._right_seen)
        return matches.take(matches.disparity_px > self._doffs_px)

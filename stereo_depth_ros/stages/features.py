# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The feature stage: matched features of a rectified pair, less what no camera could have seen."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.features.matcher import FeatureMatcher, FeatureMatches
from stereo_depth_ros.stages.camera_swap import CameraSwapDetector
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["FeatureStage"]


class FeatureStage:
    """Rectified pair to matched features of one rig; the sparse counterpart of DisparityStage, for threads as well.

    Args:
        config: the features and the search.
        rig: the cameras; their calibration says where a rectified image has pixels.

    Raises:
        ConfigError: the parameters contradict each other.
    """

    def __init__(self, config: MatchingConfig, rig: StereoRig) -> None:
        self._matcher = FeatureMatcher(config)
        self._doffs_px = rig.doffs_px
        self._swap_detector = CameraSwapDetector(rig.doffs_px)
        rectifier = Rectifier(rig)
        window = np.ones((config.correlation_window_size, config.correlation_window_size), np.uint8)
        left_seen, right_seen = (s.astype(np.uint8) for s in (rectifier.left_source, rectifier.right_source))
        # The edge of what the raw cameras saw is a line in both images, but nothing in the world.
        self._left_seen, self._right_seen = (cv2.erode(s, window, borderValue=1) for s in (left_seen, right_seen))

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

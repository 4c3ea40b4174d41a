# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stereo matching methods."""

from stereo_depth_ros.matching.protocol import Matcher
from stereo_depth_ros.matching.registry import MATCHERS, create_matcher, matcher_from_config

__all__ = ["MATCHERS", "Matcher", "create_matcher", "matcher_from_config"]

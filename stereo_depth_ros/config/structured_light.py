# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the structured light node."""

from __future__ import annotations

from dataclasses import dataclass

from stereo_depth_ros.config.parameter import Checked, parameter

__all__ = ["StructuredLightConfig"]


@dataclass(frozen=True)
class StructuredLightConfig(Checked):
    """Structured light."""

    patterns: str = parameter(
        "", "Manifest of the patterns that the projector shows, the patterns.json beside them.", run_time=False
    )
    pattern_signal: str = parameter(
        "images",
        "What tells that another pattern is shown: the images themselves (images), its number on scan/shown (topic), "
        "or a call of ~/next (service).",
        choices=("images", "topic", "service"),
        run_time=False,
    )
    settle_frames: int = parameter(
        1,
        "Images skipped after a change of the pattern; with 0 and pattern_signal images every image is a pattern.",
        low=0,
        high=100,
    )
    projector: bool = parameter(
        False,
        "Whether the right camera of the calibration is the projector, so that only the left camera has images.",
        run_time=False,
    )

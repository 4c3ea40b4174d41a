# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scanner: captures of projected patterns to the same result as that of a stereo pair."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from stereo_depth_ros.active.projector.disparity import disparity_from_projector
from stereo_depth_ros.active.shown_patterns import ShownPatterns
from stereo_depth_ros.active.structured_light.collecting import ChangingPatterns
from stereo_depth_ros.active.structured_light.correspondence import disparity_from_maps
from stereo_depth_ros.active.structured_light.projector_map import ProjectorMap
from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, U8, Frame, MatchResult, Reason, StereoPair
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.stages.depth import reject_behind
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["Capture", "Scanner", "by_changes", "settling"]

Capture: TypeAlias = tuple[Frame, ...]  # of the left and the right camera, or of the only one

_LEAST_RANGE_PX, _LARGEST_PX = 32, 2048


def by_changes(patterns: ShownPatterns, settle: int) -> ChangingPatterns[Capture]:
    """Collects the captures of patterns that only their images tell; those of the left camera count."""
    return ChangingPatterns(
        len(patterns),
        settle,
        lambda capture: to_gray(capture[0]),
        lambda captures: patterns.fault([capture[0] for capture in captures]),
    )


def settling(patterns: ShownPatterns, settle: int) -> int:
    """Captures that are skipped after a change: of a single pattern none, every capture is a scan."""
    return settle if len(patterns) > 1 else 0


class Scanner:
    """Depth from patterns that two calibrated cameras see, or one camera beside a calibrated projector.

    The images are rectified before they are decoded, so that equal codes are in equal rows.

    Args:
        config: parameters of the outputs.
        rig: both cameras, or the camera and the projector as its right one.
        patterns: what the projector shows.
    """

    def __init__(self, config: PipelineConfig, rig: StereoRig, patterns: ShownPatterns) -> None:
        self.rig = rig
        self.patterns = patterns
        self._config = config
        self._rectifier = Rectifier(rig)
        compile_kernels()

    def scan(self, captures: Sequence[Capture]) -> StereoResult:
        """Depth of a scene.

        Args:
            captures: frames of all cameras for each pattern, in the order of the sequence.

        Returns:
            The result of the capture under white light, or else of the first one; it has the stamp of that. The range
            of disparities in its config is that of the result. The right image of a projector is black.

        Raises:
            ImageError: another number of captures or cameras, images of the wrong size, or nothing can be decoded.
        """
        self._check(captures)
        start = time.perf_counter()
        shown = captures[self.patterns.best]
        pair = StereoPair(shown[0], shown[1] if len(shown) > 1 else self._black(shown[0]))
        rectified = self._rectifier.rectify(pair)
        sides = (self._rectifier.rectify_left, self._rectifier.rectify_right)
        images = [
            [rectify(image) for image in self.patterns.images([each[side] for each in captures])]
            for side, rectify in enumerate(sides[: len(shown)])
        ]
        decoding = time.perf_counter()
        maps = [self._decoded(side, gray) for side, gray in enumerate(images)]
        matching = time.perf_counter()
        match = disparity_from_maps(*maps) if len(maps) == 2 else disparity_from_projector(self.rig, maps[0])
        reject_behind(match.disparity_px, match.reasons, self.rig.doffs_px)
        config = dataclasses.replace(self._config, matching=_with_range(self._config.matching, match))
        timings_ms = {
            "rectify": 1e3 * (decoding - start),
            "decode": 1e3 * (matching - decoding),
            "match": 1e3 * (time.perf_counter() - matching),
        }
        return StereoResult(pair, rectified, match, self.rig, config, timings_ms, self._rectifier)

    def _decoded(self, side: int, images: Sequence[U8]) -> ProjectorMap:
        seen = self.patterns.decode(images)
        source = (self._rectifier.left_source, self._rectifier.right_source)[side]
        for values in (seen.column_px, seen.row_px, seen.sigma_px):
            if values is not None:
                values[~source] = np.nan
        seen.reasons[~source] |= np.uint8(Reason.BORDER)
        return seen

    def _black(self, frame: Frame) -> Frame:
        return Frame(np.zeros((self.rig.height, self.rig.width), np.uint8), frame.stamp_ns, self.rig.right.frame_id)

    def _check(self, captures: Sequence[Capture]) -> None:
        if len(captures) != len(self.patterns):
            raise ImageError(
                f"{len(captures)} captures of {len(self.patterns)} patterns",
                subject="scan",
                value=len(captures),
                limit=len(self.patterns),
                remedy="capture every pattern once",
            )
        cameras = {len(each) for each in captures}
        if cameras not in ({1}, {2}):
            raise ImageError(
                f"captures have {', '.join(map(str, sorted(cameras)))} images, all have 1 or all have 2",
                subject="scan",
                value=sorted(cameras),
                limit=(1, 2),
                remedy="take the images of all cameras for each pattern",
            )


def _with_range(config: MatchingConfig, match: MatchResult) -> MatchingConfig:
    """The config with the range of the disparities that were found, which are within what it can state.

    Raises:
        ImageError: none was found.
    """
    disparity_px: F32 = match.disparity_px
    beyond = np.abs(disparity_px) > _LARGEST_PX
    disparity_px[beyond] = np.nan
    match.reasons[beyond] |= np.uint8(Reason.RANGE)
    if np.isnan(disparity_px).all():
        counts = {name: count for name, count in match.reason_counts().items() if count}
        largest = ", ".join(f"{name} {count}" for name, count in sorted(counts.items(), key=lambda item: -item[1]))
        raise ImageError(
            f"no pixel has a depth ({largest})",
            subject="scan",
            value=counts,
            remedy="check that the projector lights the scene, that the manifest is that of the patterns, and the "
            "calibration",
        )
    low = math.floor(float(np.nanmin(disparity_px)))
    count = math.ceil((float(np.nanmax(disparity_px)) - low + 1) / 16) * 16
    return dataclasses.replace(config, min_disparity=low, num_disparities=max(count, _LEAST_RANGE_PX))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The path from a raw pair to depth, on one screen; live nodes and the offline engine call the same code."""

from __future__ import annotations

import copy
import time
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import Rig, StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, U8, MatchResult, RectifiedPair, StereoPair
from stereo_depth_ros.stages.depth import depth_from_disparity, depth_sigma
from stereo_depth_ros.stages.disparity import DisparityStage
from stereo_depth_ros.stages.point_cloud import CloudLayout, pack_points
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["StereoPipeline", "StereoResult"]


class StereoPipeline:
    """Rectify, match; depth and points follow from the result on demand.

    Several threads may call it at once: their pairs are matched one after the other.

    Args:
        config: parameters of all stages.
        rig: the cameras; with an uncalibrated one the path ends with disparities.

    Raises:
        ConfigError, CalibrationError: what cannot work, before the first frame.
    """

    def __init__(self, config: PipelineConfig, rig: Rig) -> None:
        self.config = config
        self.rig = rig
        self._rectifier = Rectifier(rig)
        self._disparity = DisparityStage(config.matching, self._rectifier)

    def with_config(self, config: PipelineConfig) -> StereoPipeline:
        """A pipeline of the same rig with other parameters; stages whose parameters are the same are shared.

        Raises:
            ConfigError: what cannot work.
        """
        other = copy.copy(self)
        other.config = config
        if config.matching != self.config.matching:
            other._disparity = DisparityStage(config.matching, self._rectifier)
        return other

    def process(self, pair: StereoPair) -> StereoResult:
        """Depth of a raw pair.

        Raises:
            CalibrationError: an image has another size than its calibration.
            ImageError: the images cannot be matched.
        """
        start = time.perf_counter()
        rectified = self._rectifier.rectify(pair)
        middle = time.perf_counter()
        disparity = self._disparity.match(rectified.left, rectified.right, lambda: self._exchanged(pair))
        timings_ms = {"rectify": 1e3 * (middle - start), "match": 1e3 * (time.perf_counter() - middle)}
        return StereoResult(pair, rectified, disparity, self.rig, self.config, timings_ms)

    def _exchanged(self, pair: StereoPair) -> tuple[U8, U8]:
        exchanged = self._rectifier.rectify(StereoPair(pair.right, pair.left))
        return exchanged.left, exchanged.right


@dataclass(frozen=True)
class StereoResult:
    """What the path knows of one pair.

    Attributes:
        pair: the images as they came.
        rectified: the rectified images.
        disparity: disparities, reasons and confidence.
        rig, config: what was used.
        timings_ms: milliseconds a stage, by its name; grows as depth and points are asked for.
    """

    pair: StereoPair
    rectified: RectifiedPair
    disparity: MatchResult
    rig: Rig
    config: PipelineConfig
    timings_ms: dict[str, float] = field(default_factory=dict)

    @property
    def stamp_ns(self) -> int:
        """Time of the left image, integer nanoseconds."""
        return self.pair.left.stamp_ns

    @property
    def frame_id(self) -> str:
        """The left optical frame."""
        return self.pair.left.frame_id

    @property
    def metric(self) -> bool:
        """Whether the disparities tell depth; without a calibrated rig they do not."""
        return self.rig.metric

    @property
    def calibrated_rig(self) -> StereoRig:
        """The rig where it is a calibrated one.

        Raises:
            CalibrationError: it is not; so do all that follow from it.
        """
        if not isinstance(self.rig, StereoRig):
            raise CalibrationError(
                "the rig is not calibrated: its disparities tell what is nearer, no depth in meters: calibrate both "
                "cameras together and take a StereoRig"
            )
        return self.rig

    @cached_property
    def triangulation(self) -> Triangulation:
        """What turns the disparities into points."""
        return Triangulation.from_rig(self.calibrated_rig)

    @cached_property
    def depth_m(self) -> F32:
        """Depth along Z of the left rectified optical frame, float32 (H, W), meters, NaN where invalid."""
        start = time.perf_counter()
        depth_m = depth_from_disparity(self.disparity.disparity_px, self.triangulation)
        self.timings_ms["depth"] = 1e3 * (time.perf_counter() - start)
        return depth_m

    @cached_property
    def sigma_m(self) -> F32:
        """Standard deviation of the depth, float32 (H, W), meters, NaN where invalid."""
        return depth_sigma(self.depth_m, self.triangulation, self.config.depth.disparity_sigma_px)

    def points(self) -> F32:
        """Points in the left rectified optical frame, float32 (H, W, 3), meters, NaN where invalid."""
        points = np.empty((*self.disparity.disparity_px.shape, 3), np.float32)
        payload: U8 = points.reshape(-1).view(np.uint8)
        pack_points(self.disparity.disparity_px, self.triangulation, CloudLayout(12, None), payload)
        return points

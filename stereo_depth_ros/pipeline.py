# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pipeline from a raw pair to depth and points, shared by the nodes and the offline engine."""

from __future__ import annotations

import copy
import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.prior import DisparityPrior
from stereo_depth_ros.core.rig import Rig, StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, U8, MatchResult, RectifiedPair, StereoPair
from stereo_depth_ros.matching.disparity_sigma import DEFAULT_SIGMA_PX, sigma_of
from stereo_depth_ros.matching.protocol import Images
from stereo_depth_ros.stages.depth import depth_from_disparity, depth_sigma
from stereo_depth_ros.stages.disparity import DisparityStage
from stereo_depth_ros.stages.point_cloud import CloudLayout, pack_points
from stereo_depth_ros.stages.rectification import Rectifier

__all__ = ["PreparedPair", "StereoPipeline", "StereoResult"]


class StereoPipeline:
    """Rectification and matching; depth and points are computed from the result on demand.

    Thread-safe: of concurrent pairs, at most :attr:`at_once` are matched at the same time. A matcher of several pairs
    matches each pair together with those prepared before it, see ``temporal_window``.

    Args:
        config: parameters of all stages.
        rig: the cameras; with an uncalibrated rig the pipeline ends with disparities.
        depth: of the rectified 16-bit images of a stream, grows with each pair; None is that of each pair alone.

    Raises:
        ConfigError, CalibrationError: invalid parameters or rig.
    """

    def __init__(self, config: PipelineConfig, rig: Rig, depth: BitDepth | None = None) -> None:
        self.config = config
        self.rig = rig
        self._depth = depth
        self._rectifier = Rectifier(rig)
        self._disparity = DisparityStage(config.matching, self._rectifier)

    @property
    def shown(self) -> float:
        """Share of the rectified images that has a source, 0..1."""
        return self._rectifier.shown

    def with_config(self, config: PipelineConfig) -> StereoPipeline:
        """A pipeline of the same rig with other parameters; stages with unchanged parameters are shared.

        Raises:
            ConfigError: invalid parameters.
        """
        other = copy.copy(self)
        other.config = config
        if config.matching != self.config.matching:
            other._disparity = DisparityStage(config.matching, self._rectifier)
        return other

    @property
    def at_once(self) -> int:
        """Pairs that are matched at the same time: 1, or one a core with a matcher that works in one thread."""
        return self._disparity.at_once

    def process(self, pair: StereoPair, prior: DisparityPrior | None = None) -> StereoResult:
        """Depth of a raw pair; ``prior`` are disparities that another sensor expects in the left rectified image.

        Raises:
            CalibrationError: an image has another size than its calibration.
            ImageError: the images cannot be matched.
            ConfigError: a prior, which the matcher does not take.
        """
        return self.match(self.prepare(pair), prior)

    def prepare(self, pair: StereoPair) -> PreparedPair:
        """The first step of :meth:`process`: rectification; of a stream, in the order of the pairs."""
        start = time.perf_counter()
        rectified = self._rectifier.rectify(pair, self._depth)
        earlier = self._disparity.earlier(rectified.left, rectified.right, pair.left.stamp_ns)
        return PreparedPair(pair, rectified, {"rectify": 1e3 * (time.perf_counter() - start)}, earlier)

    def match(self, prepared: PreparedPair, prior: DisparityPrior | None = None) -> StereoResult:
        """The second step of :meth:`process`: disparities."""
        pair, rectified = prepared.pair, prepared.rectified
        start = time.perf_counter()
        images = rectified.left, rectified.right
        disparity = self._disparity.match(*images, lambda: self._exchanged(pair), prepared.earlier, prior)
        timings_ms = {**prepared.timings_ms, "match": 1e3 * (time.perf_counter() - start)}
        return StereoResult(pair, rectified, disparity, self.rig, self.config, timings_ms, self._rectifier)

    def _exchanged(self, pair: StereoPair) -> tuple[U8, U8]:
        exchanged = self._rectifier.rectify(StereoPair(pair.right, pair.left))
        return exchanged.left, exchanged.right


@dataclass(frozen=True)
class PreparedPair:
    """A pair before it is matched.

    Attributes:
        pair: the raw images.
        rectified: the rectified images.
        timings_ms: milliseconds by name of the stage.
        earlier: the rectified pairs before it that are matched together with it.
    """

    pair: StereoPair
    rectified: RectifiedPair
    timings_ms: dict[str, float]
    earlier: tuple[Images, ...] = ()


@dataclass(frozen=True)
class StereoResult:
    """Result of the pipeline for one pair.

    Attributes:
        pair: the raw images.
        rectified: the rectified images.
        disparity: disparities, reasons and confidence.
        rig, config: those of the pipeline.
        timings_ms: milliseconds by name of the stage; depth is added when it is computed.
        rectifier: that of the pipeline.
    """

    pair: StereoPair
    rectified: RectifiedPair
    disparity: MatchResult
    rig: Rig
    config: PipelineConfig
    timings_ms: dict[str, float]
    rectifier: Rectifier = field(repr=False)

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
        """Whether depth in meters is available, which needs a calibrated rig."""
        return self.rig.metric

    @property
    def calibrated_rig(self) -> StereoRig:
        """The rig, if it is calibrated.

        Raises:
            CalibrationError: it is not; also raised by all properties that depend on it.
        """
        if not isinstance(self.rig, StereoRig):
            raise CalibrationError(
                "the rig is not calibrated, its disparities give no depth in meters",
                value=type(self.rig).__name__,
                limit="StereoRig",
                remedy="calibrate both cameras together and use a StereoRig",
            )
        return self.rig

    @cached_property
    def left_image(self) -> tuple[npt.NDArray[Any], str]:
        """The rectified left image in the encoding of the camera, and that encoding; a mosaic in color."""
        rectified, camera = self.rectified, self.pair.left.camera
        if camera is None:
            return rectified.left_color, rectified.color_encoding
        if rectified.left_16 is not None and camera.encoding == "mono16":
            return rectified.left_16, camera.encoding
        return self.rectifier.rectify_left(camera.color(self.config.rectification.debayer)), camera.encoding

    @cached_property
    def right_image(self) -> tuple[npt.NDArray[Any], str]:
        """As :attr:`left_image`, of the right camera; it is rectified on demand."""
        rectified, frame = self.rectified, self.pair.right
        if frame.camera is None:
            is_gray = frame.encoding == "mono8"
            return (rectified.right if is_gray else self.rectifier.rectify_right(frame.pixels)), frame.encoding
        if rectified.right_16 is not None and frame.camera.encoding == "mono16":
            return rectified.right_16, frame.camera.encoding
        color = frame.camera.color(self.config.rectification.debayer)
        return self.rectifier.rectify_right(color), frame.camera.encoding

    @cached_property
    def triangulation(self) -> Triangulation:
        """Conversion of the disparities to points."""
        return Triangulation.from_rig(self.calibrated_rig)

    @cached_property
    def depth_m(self) -> F32:
        """Depth along Z of the left rectified optical frame, float32 (H, W), meters, NaN where invalid."""
        start = time.perf_counter()
        depth_m = depth_from_disparity(self.disparity.disparity_px, self.triangulation)
        self.timings_ms["depth"] = 1e3 * (time.perf_counter() - start)
        return depth_m

    @cached_property
    def sigma_px(self) -> F32:
        """Standard deviation of each disparity, float32 (H, W), px, NaN where invalid.

        That of the method, or the parameter disparity_sigma_px, or by the confidence, see
        :func:`~stereo_depth_ros.matching.disparity_sigma.sigma_of`.
        """
        return sigma_of(self.disparity, self.config.matching, self.config.depth.disparity_sigma_px)

    @cached_property
    def sigma_m(self) -> F32:
        """Standard deviation of the depth, float32 (H, W), meters, NaN where invalid, of that of each disparity."""
        return depth_sigma(self.depth_m, self.triangulation, self.sigma_px)

    @property
    def noise_m(self) -> F32:
        """The noise of the depth, float32 (H, W), meters, NaN where invalid: its standard deviation for right matches.

        That of the method, or the parameter disparity_sigma_px, or 0.25 px; unlike ``sigma_m`` it does not rise where
        the match may be wrong.
        """
        estimated = self.disparity.sigma_px
        noise_px = self.config.depth.disparity_sigma_px or DEFAULT_SIGMA_PX if estimated is None else estimated
        return depth_sigma(self.depth_m, self.triangulation, noise_px)

    def points(self) -> F32:
        """Points in the left rectified optical frame, float32 (H, W, 3), meters, NaN where invalid."""
        points = np.empty((*self.disparity.disparity_px.shape, 3), np.float32)
        payload: U8 = points.reshape(-1).view(np.uint8)
        pack_points(self.disparity.disparity_px, self.triangulation, CloudLayout(12, None), payload)
        return points

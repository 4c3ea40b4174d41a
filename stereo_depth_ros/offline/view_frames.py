# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames for views from a bag or a pair of images, with the disparities of the configured matcher."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cached_property

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration
from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import CameraOrderError, ImageError, StereoDepthError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, U8, Frame, StereoPair
from stereo_depth_ros.diagnosis.opening import no_pair_error, open_selection, skipped_text
from stereo_depth_ros.matching import matcher_from_config
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.views.frame import ViewFrame
from stereo_depth_ros.views.result_frames import ResultFrames

__all__ = ["BagFrames", "map_frame", "pair_frame"]

_RATE_PAIRS = 50  # of which the median interval is the rate


class BagFrames:
    """The frames of a bag, each valid until the next one; a pair that cannot be processed is skipped.

    Args:
        selection: bag, topics and part of it.
        config: parameters of all stages.

    Attributes:
        skipped: pairs so far that could not be processed.
        warnings: what to know about the bag, a sentence each, the first error of each kind among them; final when the
            frames are exhausted.
        count: pairs of the selection at most; known with the first frame.

    Raises:
        BagError, TopicError: no readable stereo bag, or no pair that can be processed.
    """

    def __init__(self, selection: BagSelection, config: PipelineConfig) -> None:
        self._selection, choice = open_selection(selection, config.pairing)
        self._config = config
        self.skipped = 0
        self.warnings = [choice] if choice else []
        self.count = 0

    @cached_property
    def rate_hz(self) -> float:
        """Pairs per second, by the median interval of the first stamps; 10 where there is one pair."""
        with BagPairs(self._selection, self._config.pairing) as pairs:
            stamps_ns = [pair.stamp_ns for pair in itertools.islice(pairs.pairs(), _RATE_PAIRS)]
        intervals_ns = np.diff(stamps_ns)
        return float(np.clip(1e9 / np.median(intervals_ns), 1, 240)) if intervals_ns.size else 10.0

    def __iter__(self) -> Iterator[ViewFrame]:
        types, depth, rectified_depth, frames = RosbagsTypes(), BitDepth(), BitDepth(), ResultFrames()
        pipelines = PerCalibration(types, lambda rig: StereoPipeline(self._config, rig, rectified_depth))
        refused: dict[str, str] = {}
        done = 0
        with BagPairs(self._selection, self._config.pairing) as pairs:
            self.count = pairs.count
            for pair in pairs.pairs():
                try:
                    pipeline = pipelines.of(pair, pairs.topics.image_type)
                    images = pair.images(types, pairs.topics.image_type, pipeline.rig, depth)
                    frame = frames.of(pipeline.process(images))
                except CameraOrderError as error:
                    raise error.about(self._selection.path) from error
                except StereoDepthError as error:
                    self.skipped += 1
                    refused.setdefault(type(error).__name__, skipped_text(pair.stamp_ns, error))
                else:
                    done += 1
                    yield frame
            if not done:
                raise no_pair_error(pairs, self._selection.path, refused.values())
            self.warnings += [*([pairs.warning] if pairs.warning else []), *pairs.losses, *refused.values()]


def map_frame(disparity_px: F32) -> ViewFrame:
    """The frame of disparities alone, float32 (H, W), px, not finite where invalid; its range is theirs."""
    valid = disparity_px[np.isfinite(disparity_px)]
    low, high = (float(valid.min()), float(valid.max())) if valid.size else (0.0, 1.0)
    known_px = np.where(np.isfinite(disparity_px), disparity_px, np.float32(np.nan))
    return ViewFrame(known_px, 0.0, (low, high), None)


def pair_frame(left: U8, right: U8, rig: StereoRig | None, config: PipelineConfig) -> ViewFrame:
    """The frame of two images.

    Args:
        left, right: uint8 (H, W) or (H, W, 3) BGR; raw with a rig, else rectified.
        rig: the cameras; None gives no depth in meters.
        config: parameters of all stages.

    Raises:
        ImageError: the sizes differ, or the images are too small for the search range.
        CalibrationError: another size than that of the rig.
        ConfigError: parameters that contradict each other.
    """
    if left.shape != right.shape:
        raise ImageError(
            f"the images are {left.shape[1::-1]} and {right.shape[1::-1]} px, or one has color and the other has not",
            value=right.shape,
            limit=left.shape,
            remedy="use two images of one kind",
        )
    encoding = "mono8" if left.ndim == 2 else "bgr8"
    frames = ("left_optical_frame", "right_optical_frame")
    pair = StereoPair(*(Frame(each, 0, name, encoding) for each, name in zip((left, right), frames, strict=True)))
    if rig is not None:
        return ResultFrames().of(StereoPipeline(config, rig).process(pair))
    matching = config.matching
    disparity_px = matcher_from_config(matching).match(to_gray(pair.left), to_gray(pair.right)).disparity_px
    return ViewFrame(disparity_px, 0.0, (matching.min_disparity, matching.max_disparity), None, left, right)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames have both images in one form, and the disparities of the matcher again."""

from __future__ import annotations

import functools

import numpy as np
from stereo_bags import sequence

from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.types import Frame, StereoPair
from stereo_depth_ros.pipeline import StereoPipeline, StereoResult
from stereo_depth_ros.views.result_frames import ResultFrames


@functools.cache
def result_of(left: str, right: str) -> StereoResult:
    """The first pair of the synthetic sequence in these encodings."""
    made = sequence(1)
    pair = made[0].pair
    sides = []
    for side, encoding in ((pair.left, left), (pair.right, right)):
        gray = side.pixels
        pixels = np.stack([gray, gray // 2, 255 - gray], axis=-1) if encoding == "rgb8" else gray
        sides.append(Frame(pixels, side.stamp_ns, side.frame_id, encoding))
    config = PipelineConfig(matching=MatchingConfig(num_disparities=32))
    return StereoPipeline(config, made.rig).process(StereoPair(*sides))


def test_colors_are_bgr() -> None:
    result = result_of("rgb8", "rgb8")
    frame = ResultFrames().of(result)
    assert frame.left is not None and frame.right is not None
    for image, (pixels, encoding) in ((frame.left, result.left_image), (frame.right, result.right_image)):
        assert encoding == "rgb8"
        np.testing.assert_array_equal(image, pixels[..., ::-1])


def test_gray_beside_color_is_made_color() -> None:
    result = result_of("rgb8", "mono8")
    frame = ResultFrames().of(result)
    assert frame.left is not None and frame.right is not None and frame.left.shape == frame.right.shape
    np.testing.assert_array_equal(frame.right, np.repeat(result.right_image[0][..., None], 3, axis=2))


def test_disparity_and_depth_are_those_of_the_result() -> None:
    result = result_of("mono8", "mono8")
    frame = ResultFrames().of(result)
    assert frame.left is not None and frame.left.ndim == 2
    np.testing.assert_allclose(frame.disparity_px, result.disparity.disparity_px, atol=1e-5)
    np.testing.assert_allclose(frame.depth_m, result.depth_m, rtol=1e-5)
    doffs = result.calibrated_rig.doffs_px
    assert abs(doffs) > 1
    np.testing.assert_allclose(frame.range_px, (-doffs, 31 - doffs))
    assert (frame.stamp_ns, frame.frame_id) == (result.stamp_ns, result.frame_id)

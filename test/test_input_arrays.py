# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays as programs have them: views are matched as what they show, other dtypes and shapes are one clear error."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import Frame, StereoPair
from stereo_depth_ros.matching import MATCHERS, create_matcher
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.stages import rectification
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

NAMES = [name for name in MATCHERS if name != "onnx"]  # which needs a network
SCENE = SyntheticSequence(frames=1, width=120, height=90)


@pytest.fixture(scope="module")
def pair() -> StereoPair:
    return SCENE[0].pair


@pytest.mark.parametrize("name", NAMES)
def test_views_give_what_their_copies_give(name: str, pair: StereoPair) -> None:
    matcher = create_matcher(name, num_disparities=32, correlation_window_size=7)
    rows_left, rows_right = pair.left.pixels[:36], pair.right.pixels[:36]  # some matchers take seconds
    wide = np.zeros((36, 120, 3), np.uint8)
    wide[..., 1] = rows_left
    expected = matcher.match(rows_left, rows_right)
    for left, right in ((wide[..., 1], rows_right), (np.asfortranarray(rows_left), rows_right[::-1][::-1])):
        assert not left.flags.c_contiguous
        np.testing.assert_array_equal(matcher.match(left, right).disparity_px, expected.disparity_px)
    mirrored = rows_left[:, ::-1], rows_right[:, ::-1]
    flipped, copied = matcher.match(*mirrored), matcher.match(*(np.ascontiguousarray(image) for image in mirrored))
    np.testing.assert_array_equal(flipped.disparity_px, copied.disparity_px)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "change",
    [
        lambda left, right: (left.astype(np.uint16), right.astype(np.uint16)),
        lambda left, right: (left.astype(np.float32), right),
        lambda left, right: (left, right.astype(np.int8)),
        lambda left, right: (left[..., None].repeat(3, axis=2), right),
        lambda left, right: (left[:80], right),
        lambda left, right: (left > 100, right > 100),
    ],
    ids=["uint16", "float32", "int8", "color", "sizes", "bool"],
)
def test_what_cannot_be_matched_is_an_image_error(name: str, change: Callable[..., Any], pair: StereoPair) -> None:
    images = change(pair.left.pixels, pair.right.pixels)
    with pytest.raises(ImageError):
        create_matcher(name, num_disparities=32, correlation_window_size=7).match(*images)


def test_the_pipeline_leaves_its_input_as_it_is(pair: StereoPair) -> None:
    left, right = pair.left.pixels.copy(), pair.right.pixels.copy()
    frames = Frame(left, 5, SCENE.rig.left.frame_id), Frame(right, 5, SCENE.rig.right.frame_id)
    result = StereoPipeline(PipelineConfig(), SCENE.rig).process(StereoPair(*frames))
    assert result.points().shape == (90, 120, 3)
    assert result.disparity.confidence is not None
    np.testing.assert_array_equal(left, pair.left.pixels)
    np.testing.assert_array_equal(right, pair.right.pixels)
    with pytest.raises(ValueError, match="read-only"):
        result.rectified.left[0, 0] = 1


def test_maps_are_built_once_a_rig(pair: StereoPair, monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[object] = []
    build = rectification.rectification_maps
    monkeypatch.setattr(rectification, "rectification_maps", lambda camera: built.append(camera) or build(camera))
    pipeline = StereoPipeline(PipelineConfig(), SCENE.rig)
    assert built == [SCENE.rig.left, SCENE.rig.right]
    assert pipeline.process(pair).disparity.valid_fraction > 0
    assert len(built) == 2


def test_a_changed_parameter_rebuilds_its_stage_only() -> None:
    config = PipelineConfig()
    pipeline = StereoPipeline(config, SCENE.rig)
    depth = pipeline.with_config(
        dataclasses.replace(config, depth=dataclasses.replace(config.depth, depth_encoding="16UC1"))
    )
    assert depth._disparity is pipeline._disparity and depth._rectifier is pipeline._rectifier
    matching = pipeline.with_config(
        dataclasses.replace(config, matching=dataclasses.replace(config.matching, num_disparities=32))
    )
    assert matching._rectifier is pipeline._rectifier
    assert matching._disparity is not pipeline._disparity
    assert matching.config.matching.num_disparities == 32 and pipeline.config is config

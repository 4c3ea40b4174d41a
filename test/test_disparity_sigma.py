# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of disparities by confidence, their images, and the limits of what they promise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stereo_bags import PARAMETERS, write_truth_bag

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.config import DepthConfig, MatchingConfig, PipelineConfig
from stereo_depth_ros.config.more_topics import MORE_TOPICS, check_more_topics
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.matching.disparity_sigma import CONFIDENCES, SIGMAS_PX, disparity_sigma, sigma_kind
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.outputs import MORE_OUTPUTS
from stereo_depth_ros.pipeline import StereoPipeline, StereoResult
from stereo_depth_ros.stages.reason_colors import reason_colors
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

SMALL = (320, 240)


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return SyntheticSequence(3, *SMALL)


def process(sequence: SyntheticSequence, sigma_px: float = 0.0, index: int = 0, **matching: Any) -> StereoResult:
    config = PipelineConfig(matching=MatchingConfig(num_disparities=48, **matching))
    config = replace(config, depth=DepthConfig(disparity_sigma_px=sigma_px))
    return StereoPipeline(config, sequence.rig).process(sequence[index].pair)


@pytest.mark.parametrize("kind", SIGMAS_PX)
def test_tables_fall_with_the_confidence_and_are_read_linearly(kind: str) -> None:
    table = np.array(SIGMAS_PX[kind])
    assert table.size == len(CONFIDENCES) and (np.diff(table) <= 0).all() and table[-1] > 0
    confidence = np.random.default_rng(1).uniform(0, 1, (30, 40)).astype(np.float32)
    expected = np.interp(confidence, CONFIDENCES, table)
    steepest = np.abs(np.diff(table) / np.diff(CONFIDENCES)).max()
    np.testing.assert_allclose(disparity_sigma(confidence, kind), expected, atol=steepest / 2048 + 1e-6)
    ends = disparity_sigma(np.array([[0, 1]], np.float32), kind)
    np.testing.assert_allclose(ends, [[table[0], table[-1]]], atol=steepest / 2048)


@pytest.mark.parametrize(
    ("fields", "kind"),
    [
        ({}, "sgm default"),
        ({"quality": "best"}, "sgm best"),
        ({"stereo_algorithm": 0}, "bm"),
        ({"stereo_algorithm": 1}, "sgbm"),
        ({"temporal_window": 4}, None),
        ({"sgm_cost": "onnx"}, None),
        ({"stereo_algorithm": 3}, None),
    ],
)
def test_a_table_is_of_one_matcher_with_its_costs(fields: dict[str, Any], kind: str | None) -> None:
    assert sigma_kind(MatchingConfig(**fields)) == kind


@pytest.mark.parametrize("quality", ["fast", "default", "best"])
def test_errors_of_a_rendered_room_are_within_the_standard_deviations(
    sequence: SyntheticSequence, quality: str
) -> None:
    """The room is none of the scenes that the tables were fitted to; its truth is exact."""
    within = []
    for index in range(len(sequence)):
        result = process(sequence, index=index, quality=quality)
        errors_px = np.abs(result.disparity.disparity_px - sequence[index].truth_disparity_px)
        valid = np.isfinite(errors_px)
        np.testing.assert_array_equal(np.isfinite(result.sigma_px), result.disparity.reasons == 0)
        within.append([np.mean((errors_px <= times * result.sigma_px)[valid]) for times in (1, 2)])
    one, two = np.mean(within, axis=0)
    assert one > 0.6 and two > 0.9


def test_a_constant_replaces_the_table(sequence: SyntheticSequence) -> None:
    result = process(sequence, 0.5)
    valid = result.disparity.reasons == 0
    assert (result.sigma_px[valid] == 0.5).all() and np.isnan(result.sigma_px[~valid]).all()
    rig = sequence.rig
    expected = result.depth_m**2 / (rig.f_px * rig.baseline_m) * 0.5
    np.testing.assert_allclose(result.sigma_m, expected, rtol=1e-5)
    others = process(sequence, stereo_algorithm=3)  # a matcher without a table
    assert set(np.unique(others.sigma_px[others.disparity.reasons == 0])) == {np.float32(0.25)}


def test_confidence_and_errors_are_recorded_where_asked_for(tmp_path: Path) -> None:
    bag, output = tmp_path / "in.mcap", tmp_path / "out.mcap"
    write_truth_bag(bag, 2)
    results: list[StereoResult] = []
    config = pipeline_config(PARAMETERS)
    process_bag(BagSelection(bag), output, config, each=results.append, also=MORE_TOPICS[1:])
    result, types = results[0], RosbagsTypes()
    confidence = result.disparity.confidence
    assert confidence is not None
    expected: dict[str, tuple[str, F32 | np.ndarray]] = {
        "confidence": ("32FC1", confidence),
        "confidence_mono8": ("mono8", np.rint(255 * confidence).astype(np.uint8)),
        "reasons_color": ("bgr8", reason_colors(result.disparity.reasons, result.rectified.left)),
        "error_disparity": ("32FC1", result.sigma_px),
        "error_depth": ("32FC1", result.sigma_m),
    }
    with BagReader(output) as reader:
        assert "/right/image_rect_color" not in reader.topics
        for topic, (encoding, pixels) in expected.items():
            messages = [types.deserialize(m.data, m.msgtype) for m in reader.messages([f"/{topic}"])]
            assert len(messages) == 2
            image = messages[0]
            assert (image.encoding, image.header.frame_id) == (encoding, result.frame_id)
            found = image.data.view(pixels.dtype).reshape(image.height, image.width, *pixels.shape[2:])
            np.testing.assert_array_equal(found, pixels)


def test_names_of_further_outputs() -> None:
    assert tuple(row.topic for row in MORE_OUTPUTS) == MORE_TOPICS
    assert check_more_topics(["confidence", "error_depth", "confidence"]) == ("confidence", "error_depth")
    with pytest.raises(ConfigError, match=r"--also sigma: there is no such output: use one of right/image_rect_color"):
        check_more_topics(["sigma"])

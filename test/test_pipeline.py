# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pipeline API: a raw synthetic pair against its ground truth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stereo_depth_ros import MatchingConfig, PipelineConfig, Reason, StereoPipeline, StereoResult
from stereo_depth_ros.core.errors import CalibrationError, ImageError
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticFrame, SyntheticSequence

SEQUENCE = SyntheticSequence(frames=1, width=320, height=200)


@pytest.fixture(scope="module")
def frame() -> SyntheticFrame:
    return SEQUENCE[0]


@pytest.fixture(scope="module")
def result(frame: SyntheticFrame) -> StereoResult:
    return StereoPipeline(PipelineConfig(matching=MatchingConfig(num_disparities=48)), SEQUENCE.rig).process(frame.pair)


def test_disparity_and_depth_agree_with_the_truth(frame: SyntheticFrame, result: StereoResult) -> None:
    seen = ~frame.occluded & np.isfinite(result.disparity.disparity_px)
    assert seen.mean() > 0.5
    error_px = np.abs(result.disparity.disparity_px - frame.truth_disparity_px)[seen]
    assert np.median(error_px) < 0.15  # 1/16 px steps and windows over slants
    relative = np.abs(result.depth_m / frame.truth_depth_m - 1)[seen]
    assert np.median(relative) < 0.015  # 0.15 px of about 12 px


def test_points_project_onto_their_pixels(result: StereoResult) -> None:
    points = result.points()
    rig = SEQUENCE.rig
    rows, columns = np.nonzero(np.isfinite(result.depth_m))
    x, y, z = points[rows, columns].T
    np.testing.assert_array_equal(z, result.depth_m[rows, columns])
    np.testing.assert_allclose(rig.f_px * x / z + rig.cx_left, columns, atol=1e-3)
    np.testing.assert_allclose(rig.fy_px * y / z + rig.cy, rows, atol=1e-3)
    assert np.isnan(points[np.isnan(result.depth_m)]).all()


def test_sigma_grows_with_the_square_of_depth(result: StereoResult) -> None:
    rig, valid = SEQUENCE.rig, np.isfinite(result.depth_m)
    scale = result.depth_m**2 / (rig.f_px * rig.baseline_m)
    np.testing.assert_allclose(result.sigma_m[valid], (scale * result.sigma_px)[valid], rtol=1e-5)
    np.testing.assert_allclose(result.noise_m[valid], (scale * 0.25)[valid], rtol=1e-5)
    assert np.ptp(result.sigma_px[valid]) > 0.1  # by the confidence


def test_sigma_is_that_of_the_disparities_where_the_method_estimates_it(result: StereoResult) -> None:
    sigma_px = np.linspace(0.05, 0.4, result.depth_m.size, dtype=np.float32).reshape(result.depth_m.shape)
    estimated = dataclasses.replace(result, disparity=dataclasses.replace(result.disparity, sigma_px=sigma_px))
    valid = np.isfinite(result.depth_m)
    np.testing.assert_allclose(estimated.sigma_m[valid], (result.noise_m * sigma_px / 0.25)[valid], rtol=1e-5)
    np.testing.assert_array_equal(estimated.noise_m, estimated.sigma_m)


def test_invalid_pixels_have_reasons_and_valid_ones_none(result: StereoResult) -> None:
    match = result.disparity
    np.testing.assert_array_equal(match.reasons == 0, np.isfinite(match.disparity_px))
    counts = match.reason_counts()
    assert set(counts) == {reason.name for reason in Reason if reason.value}
    assert counts["LEFT_RIGHT"] >= 200  # what hides behind the poles
    assert match.valid_fraction == np.isfinite(match.disparity_px).mean()


def test_timings_name_the_stages(result: StereoResult) -> None:
    assert result.depth_m is result.depth_m
    assert {"rectify", "match", "depth"} <= set(result.timings_ms)
    assert all(ms > 0 for ms in result.timings_ms.values())


def test_a_frame_does_not_change_the_previous_result(frame: SyntheticFrame) -> None:
    pipeline = StereoPipeline(PipelineConfig(), SEQUENCE.rig)
    first = pipeline.process(frame.pair)
    before = first.disparity.disparity_px.copy(), first.disparity.reasons.copy(), first.rectified.left.copy()
    mirrored = dataclasses.replace(frame.pair.left, pixels=np.ascontiguousarray(frame.pair.left.pixels[::-1]))
    pipeline.process(StereoPair(mirrored, dataclasses.replace(frame.pair.right, pixels=mirrored.pixels)))
    after = first.disparity.disparity_px, first.disparity.reasons, first.rectified.left
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(old, new)


def test_an_image_of_another_size_is_refused(frame: SyntheticFrame) -> None:
    small = dataclasses.replace(frame.pair.right, pixels=np.zeros((200, 160), np.uint8))
    pipeline = StereoPipeline(PipelineConfig(), SEQUENCE.rig)
    with pytest.raises(CalibrationError, match=r"160x200.* 320x200"):
        pipeline.process(StereoPair(frame.pair.left, small))


def test_swapped_images_are_refused(frame: SyntheticFrame) -> None:
    pipeline = StereoPipeline(PipelineConfig(), SEQUENCE.rig)
    with pytest.raises(ImageError, match="cameras look swapped"):
        pipeline.process(StereoPair(frame.pair.right, frame.pair.left))


def test_unseen_margins_have_no_disparity(frame: SyntheticFrame) -> None:
    """Both cameras turned by 16 degrees about the baseline: still a rectified pair, with black rows above or below."""
    angle = np.deg2rad(16.0)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    left, right = (dataclasses.replace(side, R=turn @ side.R) for side in (SEQUENCE.rig.left, SEQUENCE.rig.right))
    rig = dataclasses.replace(SEQUENCE.rig, left=left, right=right)
    result = StereoPipeline(PipelineConfig(matching=MatchingConfig(num_disparities=48)), rig).process(frame.pair)
    unseen = ~Rectifier(rig).left_source
    assert unseen.all(axis=1).sum() > 20  # rows, more than the window of the matcher
    assert (result.disparity.reasons[unseen] & Reason.BORDER).all()
    assert not np.isfinite(result.disparity.disparity_px[unseen]).any()
    assert result.disparity.valid_fraction > 0.4

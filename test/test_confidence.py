# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The confidence of a result is that of the disparities it was returned with, independent of later calls."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, U8, MatchResult, Reason
from stereo_depth_ros.matching import MATCHERS, create_matcher
from stereo_depth_ros.matching.local_consistency import RADIUS, local_consistency
from stereo_depth_ros.stages.disparity import DisparityStage
from stereo_depth_ros.stages.rectification import Rectifier
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

SEQUENCE = SyntheticSequence(frames=2, width=160, height=120)
NAMES = [name for name in MATCHERS if name != "onnx"]  # that one's confidence: see test_onnx.py
FILLED = [("sgm", True), ("scanline", True)]


def turned_rig() -> StereoRig:
    """Both cameras turned by 16 degrees about the baseline: a margin above or below that neither has seen."""
    angle = np.deg2rad(16.0)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    left, right = (dataclasses.replace(side, R=turn @ side.R) for side in (SEQUENCE.rig.left, SEQUENCE.rig.right))
    return dataclasses.replace(SEQUENCE.rig, left=left, right=right)


def rectified(rig: StereoRig, number: int) -> tuple[U8, U8]:
    pair = Rectifier(rig).rectify(SEQUENCE[number].pair)
    return pair.left, pair.right


def confidence_of(result: MatchResult) -> F32:
    assert result.confidence is not None and result.confidence.dtype == np.float32
    return result.confidence


@pytest.mark.parametrize(("name", "fill_holes"), [*((name, False) for name in NAMES), *FILLED])
def test_confidence_is_unchanged_when_buffers_are_reused(name: str, fill_holes: bool) -> None:
    if name == "graph_cut":
        pytest.importorskip("maxflow")
    fields = {"num_disparities": 32, "iterations": 2, "fill_holes": fill_holes}
    first, second = (rectified(SEQUENCE.rig, number) for number in range(2))
    expected = confidence_of(create_matcher(name, **fields).match(*first)).copy()
    assert expected.any()
    matcher, out = create_matcher(name, **fields), np.empty(expected.shape, np.float32)
    result = matcher.match(*first, out)
    assert result.disparity_px is out
    matcher.match(*second, out)
    np.testing.assert_array_equal(confidence_of(result), expected)
    out.fill(7)
    np.testing.assert_array_equal(confidence_of(result), expected)


@pytest.mark.parametrize(("name", "fill_holes"), [*((name, False) for name in NAMES), *FILLED])
def test_rejected_pixels_have_no_confidence(name: str, fill_holes: bool) -> None:
    if name == "graph_cut":
        pytest.importorskip("maxflow")
    rig = turned_rig()
    images = rectified(rig, 0)
    fields = {"num_disparities": 48, "min_disparity": -12, "iterations": 2, "speckle_size": 0}
    matcher = create_matcher(name, **fields, correlation_window_size=5, uniqueness_ratio=0.0, fill_holes=fill_holes)
    matched, result = matcher.match(*images), DisparityStage(matcher.config, Rectifier(rig)).match(*images)
    removed = (matched.reasons == 0) & (result.reasons != 0)
    assert (confidence_of(matched)[removed] > 0).any()
    assert {Reason.RANGE, Reason.BORDER} & set(result.reasons[removed].tolist())
    confidence = confidence_of(result)
    assert not confidence[result.reasons != 0].any()
    kept = (result.reasons == 0) & ~(around(removed) if name != "features" else removed)
    assert (confidence[kept] > 0).any()
    np.testing.assert_array_equal(confidence[kept], confidence_of(matched)[kept])
    if name in ("bm", "sgbm", "window", "adaptive_window", "diffusion"):  # what was taken out supports no neighbor
        np.testing.assert_array_equal(confidence, local_consistency(result.disparity_px))


def around(removed: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """The pixels that count a removed one among their neighbors."""
    side = 2 * RADIUS + 1
    return np.asarray(cv2.dilate(removed.astype(np.uint8), np.ones((side, side), np.uint8)), np.bool_)


def test_an_array_of_confidences_is_zero_where_there_is_no_disparity() -> None:
    disparity_px = np.array([[5, np.nan, 7]], np.float32)
    given = np.array([[0.5, 0.75, 0.25]], np.float32)
    result = MatchResult(disparity_px, np.array([[0, Reason.SPECKLE, 0]], np.uint8), 1 / 16, given)
    np.testing.assert_array_equal(confidence_of(result), np.array([[0.5, 0, 0.25]], np.float32))
    assert given[0, 1] == 0.75

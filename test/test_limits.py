# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of confidence and depth error: what they reject, with which reason, and that the rest stays."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig, PipelineConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import MatchResult, Reason
from stereo_depth_ros.core.uncalibrated_rig import UncalibratedRig
from stereo_depth_ros.matching.disparity_sigma import disparity_sigma
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.stages.limits import Limits
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

RIG = StereoRig.from_rectified(400.0, 410.0, 60.0, 55.0, 40.0, 0.1, (90, 70))  # doffs 5 px, f B = 40
SHAPE = (70, 90)


def result(seed: int = 3) -> MatchResult:
    rng = np.random.default_rng(seed)
    disparity_px = rng.uniform(6, 40, SHAPE).astype(np.float32)
    confidence = rng.uniform(0, 1, SHAPE).astype(np.float32)
    reasons = np.where(rng.uniform(size=SHAPE) < 0.2, np.uint8(Reason.SPECKLE), np.uint8(0))
    disparity_px[reasons != 0] = np.nan
    return MatchResult(disparity_px, reasons, 1 / 64, confidence)


def limited(**fields: Any) -> MatchResult:
    return Limits(MatchingConfig(**fields), RIG)(result())


def check(found: MatchResult, rejected: np.ndarray, reason: Reason) -> None:
    before = result()
    assert 0.05 < rejected.mean() < 0.7
    assert before.confidence is not None and found.confidence is not None
    kept = (before.reasons == 0) & ~rejected
    np.testing.assert_array_equal(found.reasons, np.where(rejected, np.uint8(reason), before.reasons))
    np.testing.assert_array_equal(found.disparity_px, np.where(kept, before.disparity_px, np.nan))
    np.testing.assert_array_equal(found.confidence, np.where(kept, before.confidence, 0))
    count = np.count_nonzero(rejected)
    assert found.beyond_limits == ((count, 0) if reason == Reason.UNIQUENESS else (0, count))


def test_least_confidence() -> None:
    before = result()
    assert before.confidence is not None
    rejected = (before.reasons == 0) & (before.confidence < 0.35)
    check(limited(min_confidence=0.35), rejected, Reason.UNIQUENESS)


@pytest.mark.parametrize(("field", "limit"), [("max_depth_error", 0.08), ("max_relative_depth_error", 3.0)])
def test_largest_error_of_the_depth(field: str, limit: float) -> None:
    before = result()
    assert before.confidence is not None
    sigma_px = disparity_sigma(before.confidence, "sgm default").astype(np.float64)
    depth_m = 40 / (before.disparity_px.astype(np.float64) - 5)
    sigma_m = depth_m**2 / 40 * sigma_px
    error = sigma_m if field == "max_depth_error" else 100 * sigma_m / depth_m
    assert np.nanmin(np.abs(error - limit)) > 1e-6  # rounding decides nothing
    check(limited(**{field: limit}), (before.reasons == 0) & (error > limit), Reason.RANGE)


def test_a_pixel_may_have_both_reasons() -> None:
    reasons = limited(min_confidence=0.9, max_depth_error=0.01).reasons
    assert (reasons == Reason.UNIQUENESS | Reason.RANGE).sum() > 1000


def test_without_limits_nothing_is_computed() -> None:
    def refuse() -> np.ndarray:
        raise AssertionError("the confidence is computed")

    found = dataclasses.replace(result(), confidence_source=refuse)
    assert Limits(MatchingConfig(), RIG)(found) is found


def test_errors_of_the_depth_need_a_calibrated_rig() -> None:
    rig = UncalibratedRig.from_homographies(np.identity(3), np.identity(3), SHAPE[::-1])
    with pytest.raises(ConfigError, match="max_depth_error and max_relative_depth_error need a calibrated rig"):
        Limits(MatchingConfig(max_depth_error=1.0), rig)
    before = result()
    assert before.confidence is not None
    found = Limits(MatchingConfig(min_confidence=0.5), rig)(result())
    np.testing.assert_array_equal(found.reasons == 0, (before.reasons == 0) & (before.confidence >= 0.5))


def test_the_pipeline_applies_them_and_its_outputs_show_it() -> None:
    sequence = SyntheticSequence(1, 320, 240)
    plain, limited = (
        StereoPipeline(PipelineConfig(matching=MatchingConfig(num_disparities=48, **fields)), sequence.rig).process(
            sequence[0].pair
        )
        for fields in ({}, {"max_relative_depth_error": 4.0, "min_confidence": 0.02})
    )
    kept = np.isfinite(limited.depth_m)
    assert 0.3 < kept.mean() < np.isfinite(plain.depth_m).mean() - 0.05
    np.testing.assert_array_equal(limited.depth_m[kept], plain.depth_m[kept])
    assert (limited.sigma_m[kept] <= 0.04 * limited.depth_m[kept] * (1 + 1e-5)).all()
    counts, before = limited.disparity.reason_counts(), plain.disparity.reason_counts()
    assert counts["RANGE"] > before["RANGE"]

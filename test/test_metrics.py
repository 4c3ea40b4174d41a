# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Metrics against numbers computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.evaluation.metrics import depth_errors, disparity_errors

NAN = np.nan
# Errors 0, 0.5, 0.75, 1.5, 4 where both are known; one hole; one pixel without truth (inf) and one without both.
TRUTH = np.array([[10, 20, 30, 40], [50, 60, np.inf, NAN]], np.float32)
FOUND = np.array([[10, 20.5, 29.25, 41.5], [46, NAN, 7, NAN]], np.float32)


def test_disparity_errors_by_hand() -> None:
    errors = disparity_errors(FOUND, TRUTH)
    assert errors.density == pytest.approx(5 / 6)
    assert errors.bad_0_5 == pytest.approx(100 * 3 / 5)  # 0.5 itself is not above 0.5
    assert errors.bad_1 == pytest.approx(100 * 2 / 5)
    assert errors.bad_2 == pytest.approx(100 * 1 / 5)
    assert errors.bad_4 == 0  # 4 itself is not above 4
    assert errors.bad_0_5_all == pytest.approx(100 * 4 / 6)
    assert errors.bad_1_all == pytest.approx(100 * 3 / 6)
    assert errors.bad_2_all == pytest.approx(100 * 2 / 6)
    assert errors.bad_4_all == pytest.approx(100 * 1 / 6)
    assert errors.avg_px == pytest.approx(6.75 / 5)
    assert errors.median_px == pytest.approx(0.75)
    assert errors.rms_px == pytest.approx(math.sqrt((0.25 + 0.5625 + 2.25 + 16) / 5))


def test_error_quantiles_by_hand() -> None:
    errors = disparity_errors(FOUND, TRUTH)  # five errors: the quantile q is 4 q after the first
    assert errors.a90_px == pytest.approx(1.5 + 0.6 * 2.5)
    assert errors.a95_px == pytest.approx(1.5 + 0.8 * 2.5)
    assert errors.a99_px == pytest.approx(1.5 + 0.96 * 2.5)


def test_d1_is_wrong_by_more_than_3_px_and_by_more_than_5_percent() -> None:
    truth = np.array([[100, 60, 10, 59, 64, 40, 30]], np.float32)
    found = np.array([[104, 63.5, 13, 63, 60, NAN, 30]], np.float32)  # 4 %, 5.8 %, 3 px, 6.8 %, 6.25 %, a hole, right
    errors = disparity_errors(found, truth)
    assert errors.d1 == pytest.approx(100 * 3 / 6)
    assert errors.d1_all == pytest.approx(100 * 4 / 7)
    assert errors.bad_2 == pytest.approx(100 * 5 / 6)  # 3 px and 4 % are wrong here
    at_limit = disparity_errors(np.array([[84.0]], np.float32), np.array([[80.0]], np.float32))
    assert at_limit.d1 == 0  # 5 % itself is not above 5 %


def test_mask_selects_pixels() -> None:
    mask = np.array([[False, True, False, False], [True, True, True, False]])
    errors = disparity_errors(FOUND, TRUTH, mask)
    assert errors.density == pytest.approx(2 / 3)
    assert errors.avg_px == pytest.approx(4.5 / 2)
    assert errors.bad_2_all == pytest.approx(100 * 2 / 3)


def test_nothing_to_compare_is_nan_not_zero() -> None:
    unknown = disparity_errors(FOUND, np.full_like(TRUTH, NAN))
    assert math.isnan(unknown.density) and math.isnan(unknown.bad_2_all) and math.isnan(unknown.median_px)
    empty = disparity_errors(np.full_like(FOUND, NAN), TRUTH)
    assert (empty.density, empty.bad_2_all) == (0, 100)
    assert math.isnan(empty.a99_px) and math.isnan(empty.d1) and empty.d1_all == 100
    assert math.isnan(empty.bad_2) and math.isnan(empty.avg_px) and math.isnan(empty.rms_px)


def test_depth_errors_by_hand() -> None:
    truth = np.array([[2, 4, 5], [8, NAN, 1]], np.float32)
    found = np.array([[2.5, 4, 4], [NAN, 3, -np.inf]], np.float32)  # errors 0.5, 0, 1; relative 0.25, 0, 0.2
    errors = depth_errors(found, truth)
    assert errors.density == pytest.approx(3 / 5)
    assert errors.median_m == pytest.approx(0.5)
    assert errors.median_relative == pytest.approx(0.2)


def test_shapes_must_agree() -> None:
    with pytest.raises(ImageError, match=r"result is \(2, 4\), truth \(4, 2\).*one shape"):
        disparity_errors(FOUND, TRUTH.reshape(4, 2))
    with pytest.raises(ImageError, match=r"mask \(2, 3\)"):
        disparity_errors(FOUND, TRUTH, np.ones((2, 3), bool))
    with pytest.raises(ImageError, match="one shape"):
        depth_errors(FOUND[:1], TRUTH)


def test_signed_error_and_its_spread_by_hand() -> None:
    errors = disparity_errors(FOUND, TRUTH)  # 0, 0.5, -0.75, 1.5, -4
    assert errors.signed_median_px == 0
    assert errors.spread_px == pytest.approx(1.4826 * 0.75)
    nothing = disparity_errors(np.full_like(FOUND, NAN), TRUTH)
    assert math.isnan(nothing.signed_median_px) and math.isnan(nothing.spread_px)
    assert nothing.constant_bias_px is None


@pytest.mark.parametrize("bias_px", [1.8, -0.8])
@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_disparities_that_are_all_shifted_are_biased(bias_px: float, wrong: float) -> None:
    """A network whose input was padded on one side; a third of its pixels may be wrong besides."""
    rng = np.random.default_rng(5)
    truth = np.linspace(3, 60, 20_000, dtype=np.float32).reshape(100, 200)
    found = (truth + bias_px + rng.normal(0, 0.25, truth.shape)).astype(np.float32)
    outliers = rng.random(truth.shape) < wrong
    found[outliers] = rng.uniform(0, 64, outliers.sum())
    found[:10] = NAN
    errors = disparity_errors(found, truth)
    assert errors.constant_bias_px == errors.signed_median_px == pytest.approx(bias_px, abs=0.1)


def test_what_is_not_shifted_is_not_biased() -> None:
    rng = np.random.default_rng(6)
    truth = np.linspace(3, 60, 20_000, dtype=np.float32).reshape(100, 200)
    noisy = truth + rng.normal(0, 3, truth.shape).astype(np.float32)
    half_wrong = np.where(np.arange(200) < 90, truth + 5, truth + np.float32(0.1))  # 45 % of the image, all too near
    scaled = truth * np.float32(1.1)  # up to 6 px too near, 3 px in the middle of the range
    coarse = np.float32(10.5) + 0 * truth  # a plane between two whole disparities
    for found, known in (
        (noisy, truth),
        (half_wrong, truth),
        (scaled, truth),
        (np.ceil(coarse), coarse),
        (np.round(truth), truth),
    ):
        assert disparity_errors(found.astype(np.float32), known).constant_bias_px is None

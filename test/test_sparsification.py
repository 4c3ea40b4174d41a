# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sparsification curves by hand and in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.evaluation.sparsification import SparsificationCurve, sparsification


def curve_of(confidence: list[float] | F32, error: list[float] | F64) -> SparsificationCurve:
    curve = sparsification(np.asarray(confidence, np.float32), np.asarray(error, np.float64))
    assert curve is not None
    return curve


def test_curve_and_areas_by_hand() -> None:
    curve = curve_of([0.9, 0.5, 0.7, 0.1], [0, 2, 4, 6])  # by confidence: 0, 4, 2, 6
    np.testing.assert_allclose(curve.error, [0, 2, 2, 3])
    np.testing.assert_allclose(curve.oracle, [0, 1, 2, 3])
    assert (curve.area, curve.oracle_area, curve.random_area) == pytest.approx((1.75, 1.5, 3))
    assert [curve.at(kept) for kept in (0.01, 0.25, 0.26, 1.0)] == pytest.approx([0, 0, 2, 3])


def test_equal_confidences_count_as_random_order() -> None:
    np.testing.assert_allclose(curve_of([1, 1, 0], [0, 4, 8]).error, [2, 2, 4])
    np.testing.assert_allclose(curve_of([1, 1, 0], [4, 0, 8]).error, [2, 2, 4])  # in any order
    constant = curve_of([0.5] * 5, [0, 0, 9, 9, 2])
    assert constant.area == pytest.approx(constant.random_area) == pytest.approx(4)


def test_areas_of_random_best_and_worst_order() -> None:
    rng = np.random.default_rng(3)
    error = np.where(rng.random(20000) < 0.2, 100.0, 0.0)
    rate = error.mean() / 100
    best = curve_of((1 - error / 100).astype(np.float32), error)
    # Hu and Mordohai 2012, equation 19: the best area of a rate e is e + (1 - e) ln(1 - e); a sum of 20000 terms is
    # within 1/20000 of the integral.
    assert best.area == pytest.approx(100 * (rate + (1 - rate) * np.log(1 - rate)), abs=0.02)
    assert best.area == pytest.approx(best.oracle_area)
    random = curve_of(rng.random(20000).astype(np.float32), error)
    assert random.area == pytest.approx(random.random_area, rel=0.05)  # 4000 wrong pixels: about 1.6 % of noise
    assert curve_of((error / 100).astype(np.float32), error).area > 2 * random.area


def test_no_pixels_have_no_curve() -> None:
    assert sparsification(np.empty(0, np.float32), np.empty(0)) is None


@pytest.mark.parametrize(
    ("confidence", "found"), [([0.5, 1.2], r"0\.5\.\.1\.2"), ([-0.1, 1], "-0.1"), ([np.nan, 1], "nan")]
)
def test_confidence_outside_0_to_1_is_refused(confidence: list[float], found: str) -> None:
    with pytest.raises(ImageError, match=f"confidence is .*{found}.* within 0..1"):
        curve_of(confidence, [0, 0])


def test_shapes_must_agree() -> None:
    with pytest.raises(ImageError, match=r"confidence is \(3,\), errors are \(2,\)"):
        curve_of([1, 1, 1], [0, 0])

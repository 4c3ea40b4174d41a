# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robust standard deviation."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.geometry.robust import robust_sigma


def test_normal_deviations_have_their_standard_deviation() -> None:
    deviations = np.random.default_rng(1).normal(0.0, 3.0, 100_000)
    assert robust_sigma(deviations) == pytest.approx(3.0, rel=0.01)


def test_a_third_of_outliers_to_one_side_hardly_counts() -> None:
    rng = np.random.default_rng(2)
    deviations = np.concatenate([rng.normal(0.0, 3.0, 60_000), rng.uniform(100.0, 1000.0, 30_000)])
    # Of normal deviations, 3/4 are within 1.1503 standard deviations, and half of all are 3/4 of the normal ones.
    assert robust_sigma(deviations) == pytest.approx(1.4826 * 1.1503 * 3.0, rel=0.01)

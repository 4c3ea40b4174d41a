# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local consistency against explicit counting, and the value of the confidences."""

from __future__ import annotations

from pathlib import Path

import middlebury2001
import numpy as np
import pytest

from stereo_depth_ros.core import bands as parallel
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.evaluation.sparsification import sparsification
from stereo_depth_ros.matching import MATCHERS, create_matcher
from stereo_depth_ros.matching.local_consistency import local_consistency


def counted(disparity_px: F32) -> F32:
    """By the definition: 48 of the pixels around, 3 apart, that differ by at most 1 px."""
    height, width = disparity_px.shape
    shares = np.zeros(disparity_px.shape, np.float32)
    for y, x in np.ndindex(disparity_px.shape):
        around = [
            disparity_px[y + j, x + i]
            for j in range(-9, 10, 3)
            for i in range(-9, 10, 3)
            if (i or j) and 0 <= y + j < height and 0 <= x + i < width
        ]
        shares[y, x] = sum(abs(value - disparity_px[y, x]) <= 1 for value in around) / 48
    return shares


@pytest.mark.parametrize("shape", [(41, 70), (5, 33), (80, 7), (1, 1)])
def test_consistency_is_the_share_of_similar_neighbors(shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    disparity_px = (rng.integers(0, 4, shape) + rng.random(shape)).astype(np.float32)
    disparity_px[rng.random(shape) < 0.2] = np.nan
    for cores in (1, 3):
        monkeypatch.setattr(parallel, "core_count", lambda cores=cores: cores)
        np.testing.assert_allclose(local_consistency(disparity_px), counted(disparity_px), atol=1e-6)
    margin = rng.random(shape, np.float32)
    np.testing.assert_allclose(local_consistency(disparity_px, margin), counted(disparity_px) * margin, atol=1e-6)


@pytest.mark.parametrize("name", ["bm", "sgbm", "window", "adaptive_window", "diffusion"])
def test_it_is_the_confidence_of_methods_without_a_margin(name: str) -> None:
    rng = np.random.default_rng(2)
    wide = rng.integers(0, 256, (90, 200), dtype=np.uint8)
    left, right = np.ascontiguousarray(wide[:, :160]), np.ascontiguousarray(wide[:, 8:168])
    result = create_matcher(name, num_disparities=32, correlation_window_size=5, uniqueness_ratio=0.0).match(
        left, right
    )
    assert result.confidence is not None
    np.testing.assert_array_equal(result.confidence, local_consistency(result.disparity_px))
    assert not result.confidence[result.reasons != 0].any()
    assert result.confidence is result.confidence, "computed once"


@pytest.mark.real_data
@pytest.mark.parametrize("scene", ["tsukuba", "venus"])
@pytest.mark.parametrize("name", [name for name in MATCHERS if name not in ("features", "onnx")])
def test_confidence_of_every_dense_method_predicts_errors(name: str, scene: str, stereo_data: Path) -> None:
    of = middlebury2001.part(middlebury2001.scene(scene, stereo_data), slice(100, 220))
    found = create_matcher(name, num_disparities=32).match(of.left, of.right)
    known = np.isfinite(found.disparity_px) & np.isfinite(of.truth_px)
    assert found.confidence is not None
    wrong = np.where(np.abs(found.disparity_px - of.truth_px)[known] > 1, 100.0, 0.0)
    curve = sparsification(found.confidence[known], wrong)
    assert curve is not None and 0 < curve.area <= 0.5 * curve.random_area

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Semi-global block matching equals OpenCV's bit for bit, for random parameters and where its 16 bits saturate."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.types import U8, Reason
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.matching.sgm.block_costs import I16
from stereo_depth_ros.matching.sgm.semi_global_block_matching import penalties

BATCH, BATCHES = 12, 4  # draws of parameters


def opencv(left: U8, right: U8, config: MatchingConfig) -> I16:
    """The disparities of OpenCV in 1/16 px."""
    matcher = cv2.StereoSGBM.create(
        config.min_disparity,
        config.num_disparities,
        config.correlation_window_size,
        *penalties(config),
        config.disp12_max_diff,
        config.prefilter_cap,
        int(config.uniqueness_ratio),
        0,
        0,
        config.sgbm_mode,
    )
    return np.asarray(matcher.compute(left, right), np.int16)


def check_equal(left: U8, right: U8, **fields: Any) -> None:
    matcher = create_matcher("sgbm", speckle_size=0, **fields)
    expected = opencv(left, right, matcher.config)
    invalid = expected == (matcher.config.min_disparity - 1) * 16
    found = matcher.match(left, right)
    np.testing.assert_array_equal(found.disparity_px, np.where(invalid, np.nan, expected / np.float32(16)), str(fields))
    np.testing.assert_array_equal(found.reasons == 0, ~invalid)


def drawn_parameters(rng: np.random.Generator) -> dict[str, Any]:
    count, cap = int(rng.choice([32, 48, 64, 80, 128, 144])), int(rng.choice([1, 16, 31, 62, 63]))
    P1 = int(rng.choice([0, 1, 10, 200, 1000, 3999]))
    return {
        "num_disparities": count,
        "min_disparity": int(rng.integers(-count - 30, 40)),
        "correlation_window_size": int(rng.choice([1, 3, 5, 9, 15, 17, 21 if cap < 40 else 13])),
        "P1": float(P1),
        "P2": float(rng.choice([0, P1 + 1, 4000])),
        "uniqueness_ratio": float(rng.choice([0, 1, 5, 15, 50, 98, 99])),
        "disp12_max_diff": int(rng.choice([0, 1, 2, 5])),
        "prefilter_cap": cap,
        "sgbm_mode": int(rng.choice([0, 0, 1, 2, 2])),
    }


def drawn_pair(rng: np.random.Generator, fields: dict[str, Any]) -> tuple[U8, U8]:
    """As small as the search allows, or a little larger: noise, shifted texture, black and white, or its negative."""
    low, count, window = fields["min_disparity"], fields["num_disparities"], fields["correlation_window_size"]
    width = window + max(0, low + count - 1) + max(0, -low) + int(rng.integers(0, 40))
    height = window + int(rng.integers(0, 25 if fields["sgbm_mode"] < 2 else 70))
    kind = rng.choice(["noise", "texture", "binary", "negative"])
    wide = rng.integers(0, 256, (height, width + count)).astype(np.uint8)
    if kind == "noise":
        return wide[:, :width].copy(), rng.integers(0, 256, (height, width)).astype(np.uint8)
    wide = cv2.GaussianBlur(wide, (0, 0), 1.2)
    if kind != "texture":
        wide = np.where(wide > np.median(wide), 255, 0).astype(np.uint8)
    shift = np.clip(np.arange(height) * 2, 0, count // 2)  # slanted
    left = np.stack([row[count // 2 - s : count // 2 - s + width] for row, s in zip(wide, shift, strict=True)])
    right = wide[:, count // 2 : count // 2 + width]
    return left, np.ascontiguousarray(255 - right if kind == "negative" else right)


@pytest.mark.parametrize("batch", range(BATCHES))
def test_random_parameters(batch: int) -> None:
    for seed in range(batch * BATCH, (batch + 1) * BATCH):
        rng = np.random.default_rng(seed)
        fields = drawn_parameters(rng)
        check_equal(*drawn_pair(rng, fields), **fields)


@pytest.mark.parametrize("mode", [0, 1, 2])
@pytest.mark.parametrize("P2", [0.0, 4000.0])
def test_sums_that_saturate(mode: int, P2: float) -> None:
    """A pattern and its negative have the largest costs, of which whole windows leave 16 bits, beside a real match."""
    rng = np.random.default_rng(3)
    bars = np.repeat(rng.integers(0, 2, (70, 60)) * 255, 3, axis=1).astype(np.uint8)
    left, right = bars[:, :150].copy(), (255 - bars[:, 5:155]).astype(np.uint8)
    right[45:] = bars[45:, 5:155]
    check_equal(
        left,
        right,
        num_disparities=48,
        min_disparity=-4,
        correlation_window_size=21,
        P2=P2,
        P1=0.0,
        uniqueness_ratio=0.0,
        sgbm_mode=mode,
    )


@pytest.mark.parametrize("mode", [0, 1, 2])
@pytest.mark.parametrize("low", [-50, -32, 0, 7])
def test_images_with_no_or_one_column_that_has_all_disparities(mode: int, low: int) -> None:
    rng = np.random.default_rng(low + 100)
    fields = {"num_disparities": 32, "min_disparity": low, "correlation_window_size": 1, "sgbm_mode": mode}
    columns = 0 if low + 32 > 0 else 1  # of the smallest image that a matcher accepts
    width = columns + max(0, low + 32) + max(0, -low)
    left, right = rng.integers(0, 256, (2, 9, width + 1)).astype(np.uint8)
    check_equal(left, right, **fields)
    if columns == 0:  # an error of OpenCV
        result = create_matcher("sgbm", **fields).match(left[:, 1:], right[:, 1:])
        assert (result.reasons == Reason.BORDER).all()


@pytest.mark.parametrize("mode", [0, 1])
def test_all_others_are_as_near_at_100_percent(mode: int) -> None:
    rng = np.random.default_rng(11)
    left = rng.integers(0, 256, (30, 90)).astype(np.uint8)
    left[:, 40:60] = 0  # the lowest sum is 0
    check_equal(left, left, num_disparities=32, correlation_window_size=3, uniqueness_ratio=100.0, sgbm_mode=mode)


@pytest.mark.parametrize("window", [1, 5])
def test_of_equal_sums_of_three_directions_the_one_of_opencv(window: int) -> None:
    """Flat images and images of few grays; OpenCV keeps the last one of each lane of its vectors."""
    rng = np.random.default_rng(12)
    left, right = (rng.integers(0, 3, (2, 61, 190)) // 2 * 9).astype(np.uint8)
    fields = {"num_disparities": 80, "correlation_window_size": window, "sgbm_mode": 2, "uniqueness_ratio": 0.0}
    check_equal(left, right, P1=1.0, P2=2.0, disp12_max_diff=50, **fields)
    check_equal(np.full_like(left, 50), np.full_like(left, 50), **fields)


def test_images_without_texture_and_of_other_sizes_follow_each_other() -> None:
    """The buffers of a matcher keep nothing of the frame before."""
    rng = np.random.default_rng(8)
    matcher = create_matcher("sgbm", num_disparities=32, correlation_window_size=5, speckle_size=0)
    for shape in ((40, 90), (40, 90), (33, 101), (40, 90)):
        left, right = rng.integers(0, 256, (2, *shape)).astype(np.uint8)
        flat = np.full(shape, 77, np.uint8)
        for pair in ((left, right), (flat, flat), (left, left)):
            expected = opencv(*pair, matcher.config)
            invalid = expected == -16
            found = matcher.match(*pair).disparity_px
            np.testing.assert_array_equal(found, np.where(invalid, np.nan, expected / np.float32(16)))

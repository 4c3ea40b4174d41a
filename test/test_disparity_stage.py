# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The disparity stage: the matcher's disparities, less those that a raw camera did not see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8, Reason
from stereo_depth_ros.matching import matcher_from_config
from stereo_depth_ros.stages.disparity import DisparityStage

WIDTH, HEIGHT = 200, 120
HALF_WINDOW = 3
# By how many columns and rows the raw image lies to the right of and below the rectified one, where it was not seen.
LEFT_OFFSET, RIGHT_OFFSET = (-20, 9), (26, -13)


def offset_rig() -> StereoRig:
    """Raw cameras whose principal points are off; infinity is at -3 px, so that nothing found lies behind it."""
    rig = StereoRig.from_rectified(250.0, 240.0, 101.0, 104.0, 57.0, 0.1, (WIDTH, HEIGHT))
    cameras = []
    for camera, offset in ((rig.left, LEFT_OFFSET), (rig.right, RIGHT_OFFSET)):
        K = camera.K.copy()
        K[:2, 2] -= offset
        cameras.append(replace(camera, K=K))
    return StereoRig(*cameras)


def seen(offset: tuple[int, int]) -> np.ndarray:
    """bool (H, W), where the whole window lies in what the raw camera saw."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    inside = np.ones((HEIGHT, WIDTH), bool)
    for step in (-HALF_WINDOW, HALF_WINDOW):
        for place, moved, size in ((x, offset[0], WIDTH), (y, offset[1], HEIGHT)):
            raw = np.clip(place + step, 0, size - 1) - moved
            inside &= (raw >= 0) & (raw < size)
    return inside


def textured_pair() -> tuple[U8, U8]:
    """Disparities of 7 px above and 18.5 px below."""
    noise = np.random.default_rng(8).integers(0, 255, (HEIGHT, WIDTH + 40)).astype(float)
    smooth = (noise + np.roll(noise, 1, axis=1)) / 2
    left, right = smooth[:, :WIDTH], np.empty((HEIGHT, WIDTH))
    right[:60] = smooth[:60, 7 : 7 + WIDTH]
    right[60:] = (smooth[60:, 18 : 18 + WIDTH] + smooth[60:, 19 : 19 + WIDTH]) / 2
    return left.astype(np.uint8), right.astype(np.uint8)


@pytest.mark.parametrize("fill_holes", [False, True])
def test_a_disparity_takes_both_raw_cameras(fill_holes: bool) -> None:
    """Each its own: what the left one did not see, what the right one did not see, and what is beside its image."""
    config = MatchingConfig(num_disparities=32, correlation_window_size=2 * HALF_WINDOW + 1, fill_holes=fill_holes)
    left, right = textured_pair()
    every = matcher_from_config(config).match(left, right)
    disparity_px, reasons = every.disparity_px.copy(), every.reasons.copy()
    found = np.isfinite(disparity_px)
    at = np.arange(WIDTH) - np.rint(np.where(found, disparity_px, 0)).astype(int)
    beside = found & (at < 0)
    right_seen = np.take_along_axis(seen(RIGHT_OFFSET), at.clip(0), axis=1)
    left_only, right_only = (
        (seen(LEFT_OFFSET) & found & ~right_seen & ~beside),
        (found & right_seen & ~seen(LEFT_OFFSET)),
    )
    assert left_only.sum() > 1000 and right_only.sum() > 1000
    assert (beside & seen(LEFT_OFFSET)).any()

    result = DisparityStage(config, offset_rig()).match(left, right)
    unseen = ~seen(LEFT_OFFSET) | (found & ~right_seen) | beside
    np.testing.assert_array_equal(result.disparity_px, np.where(unseen, np.float32(np.nan), disparity_px))
    np.testing.assert_array_equal(result.reasons, np.where(unseen, reasons | np.uint8(Reason.BORDER), reasons))

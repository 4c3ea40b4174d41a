# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Disparity stage: the disparities of the matcher, without those of unseen pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.config.matchers import matcher_number
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import U8, Reason
from stereo_depth_ros.matching import matcher_from_config
from stereo_depth_ros.stages.disparity import DisparityStage
from stereo_depth_ros.stages.rectification import Rectifier

WIDTH, HEIGHT = 200, 120
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


def seen(offset: tuple[int, int], support_px: tuple[int, int]) -> np.ndarray:
    """bool (H, W), where the whole support is in the valid pixels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    inside = np.ones((HEIGHT, WIDTH), bool)
    for place, moved, size, support in ((x, offset[0], WIDTH, support_px[0]), (y, offset[1], HEIGHT, support_px[1])):
        for step in (-(support // 2), support // 2):
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


@pytest.mark.parametrize(
    ("matcher", "fill_holes", "support_px"),
    [("sgm", False, (7, 5)), ("sgm", True, (7, 5)), ("window", False, (5, 5))],
)
def test_a_disparity_needs_valid_pixels_of_both_cameras(
    matcher: str, fill_holes: bool, support_px: tuple[int, int]
) -> None:
    """Rejected separately: unseen in the left image, unseen in the right image, and outside the right image."""
    config = MatchingConfig(
        stereo_algorithm=matcher_number(matcher),
        num_disparities=32,
        correlation_window_size=5,
        fill_holes=fill_holes,
    )
    left, right = textured_pair()
    left_seen, right_image_seen = seen(LEFT_OFFSET, support_px), seen(RIGHT_OFFSET, support_px)
    every = matcher_from_config(config).match(left, right)
    assert every.support_px == support_px
    disparity_px, reasons = every.disparity_px.copy(), every.reasons.copy()
    found = np.isfinite(disparity_px)
    at = np.arange(WIDTH) - np.rint(np.where(found, disparity_px, 0)).astype(int)
    beside = found & (at < 0)
    right_seen = np.take_along_axis(right_image_seen, at.clip(0), axis=1)
    left_only, right_only = (
        (left_seen & found & ~right_seen & ~beside),
        (found & right_seen & ~left_seen),
    )
    assert left_only.sum() > 1000 and right_only.sum() > 1000
    assert (beside & left_seen).any()

    result = DisparityStage(config, Rectifier(offset_rig())).match(left, right)
    unseen = ~left_seen | (found & ~right_seen) | beside
    np.testing.assert_array_equal(result.disparity_px, np.where(unseen, np.float32(np.nan), disparity_px))
    np.testing.assert_array_equal(result.reasons, np.where(unseen, reasons | np.uint8(Reason.BORDER), reasons))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Colors of the reasons, and their plot."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.core.types import Reason
from stereo_depth_ros.plots.reasons import reason_plot
from stereo_depth_ros.stages.reason_colors import REASON_COLORS, VALID_DIMMED, reason_colors


def test_every_reason_has_a_color_of_its_own_that_is_not_gray_of_the_image() -> None:
    assert set(REASON_COLORS) == {reason for reason in Reason if reason.value}
    assert len(set(REASON_COLORS.values())) == len(REASON_COLORS)
    lightest = VALID_DIMMED * 255
    assert all(max(color) > lightest or len(set(color)) > 1 for color in REASON_COLORS.values())


def test_pixels_with_a_disparity_show_the_image_and_the_others_their_reason() -> None:
    left = np.random.default_rng(2).integers(0, 256, (4, 9), np.uint8)
    reasons = np.zeros((4, 9), np.uint8)
    for column, reason in enumerate(REASON_COLORS):
        reasons[1, column] = reason
    reasons[2, 3] = Reason.SPECKLE | Reason.BORDER  # the first in the table
    colors = reason_colors(reasons, left)
    np.testing.assert_array_equal(colors[1, : len(REASON_COLORS)], list(REASON_COLORS.values()))
    assert tuple(colors[2, 3]) == REASON_COLORS[Reason.BORDER]
    expected = np.rint(VALID_DIMMED * left[[0, 3]].astype(float))
    np.testing.assert_array_equal(colors[[0, 3]], np.repeat(expected[..., None], 3, axis=2))


@pytest.mark.parametrize("with_confidence", [True, False])
def test_the_plot_has_both_panels(with_confidence: bool) -> None:
    rng = np.random.default_rng(4)
    left = rng.integers(0, 256, (240, 320), np.uint8)
    reasons = rng.choice([0, int(Reason.UNIQUENESS), int(Reason.LEFT_RIGHT)], (240, 320)).astype(np.uint8)
    confidence = rng.uniform(0, 1, (240, 320)).astype(np.float32) * (reasons == 0)
    image = reason_plot(left, reasons, confidence if with_confidence else None, "a scene")
    assert image.dtype == np.uint8 and image.shape[2] == 3 and image.shape[1] > 2 * 560
    middle = image[60:400, 700:1100]
    assert (middle.std() > 20) == with_confidence
    for reason in (Reason.UNIQUENESS, Reason.LEFT_RIGHT):
        assert (image[:, :570] == REASON_COLORS[reason]).all(axis=2).mean() > 0.1

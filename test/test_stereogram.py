# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stereograms are decoded by matching them with themselves, which gives the disparities back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.views.stereogram import separations, stereogram

WIDTH, HEIGHT = 420, 90


def scene() -> F32:
    """A wall, a slanted floor, a box in front of it with a step, and a hole."""
    disparity_px = np.full((HEIGHT, WIDTH), 5.0, np.float32)
    disparity_px[60:] = np.linspace(5, 20, HEIGHT - 60, dtype=np.float32)[:, None]
    disparity_px[15:75, 150:260] = 25
    disparity_px[30:60, 180:230] = 35
    disparity_px[5:10, 300:340] = np.nan
    return disparity_px


def decoded(image: U8, far: int) -> F32:
    """The separation at each point: where a window around its two pixels is equal most, by definition."""
    values = np.pad(image.astype(np.float32), ((0, 0), (far, far)))
    costs = []
    found = np.arange(round(0.75 * far), far + 3)
    for s in found:
        first = far - s // 2
        difference = np.abs(values[:, first : first + WIDTH] - values[:, first + s : first + s + WIDTH])
        costs.append(cv2.blur(difference, (13, 5)))
    return found[np.argmin(costs, axis=0)].astype(np.float32)


@pytest.mark.parametrize("kind", ["dots", "texture"])
def test_disparities_are_decoded(kind: str) -> None:
    texture = None
    if kind == "texture":
        texture = np.random.default_rng(3).integers(0, 256, (40, 64), np.uint8)
    image = stereogram(scene(), texture)
    separation, far = separations(scene())
    assert image.shape == (HEIGHT, WIDTH)
    error = np.abs(decoded(image, far) - separation)
    inner = np.zeros(error.shape, bool)
    inner[4:-4, far:-far] = True
    assert np.mean(error[inner] <= 1) > 0.93  # not at the edges of the boxes, where one side sees what is hidden
    flat = inner & (cv2.morphologyEx(separation, cv2.MORPH_GRADIENT, np.ones((11, 31))) < 2)
    assert np.mean(error[flat] <= 1) > 0.99


def test_separations_are_linear_in_the_disparity() -> None:
    separation, far = separations(scene())
    assert far == 60
    assert separation[20, 10] == 60 == separation[7, 320]  # the hole is background
    assert separation[40, 200] == pytest.approx(48)
    assert separation[20, 160] == pytest.approx(60 - 12 * 20 / 30)


@pytest.mark.parametrize(
    ("hidden", "visible"),
    [(range(143, 150), range(125, 143)), (range(260, 267), range(267, 285))],
    ids=["left", "right"],
)
def test_points_hidden_from_one_side_are_not_linked(hidden: range, visible: range) -> None:
    """Separations are 60 px at the wall and 52 px at the box in the columns 150 to 259, the sides 120 px apart.

    The line of sight from a point of the wall to one side is in front of the box after 120 / 2 * mu z / 2 = 7.06 px,
    with mu z = (120 - 2 * 52) / (120 - 52): 7 px of the wall are hidden on either side of the box.
    """
    dots = stereogram(scene())[16:28]
    assert not any(np.array_equal(dots[:, x - 30], dots[:, x + 30]) for x in hidden)
    assert all(np.array_equal(dots[:, x - 30], dots[:, x + 30]) for x in visible)


def test_dots_depend_on_the_seed_only() -> None:
    np.testing.assert_array_equal(stereogram(scene()), stereogram(scene()))
    assert 0.4 < np.mean(stereogram(scene()) != stereogram(scene(), seed=2)) < 0.6
    assert set(np.unique(stereogram(scene()))) == {0, 255}


def test_flat_map_repeats_the_texture() -> None:
    texture = np.random.default_rng(1).integers(0, 256, (7, 20, 3), np.uint8)
    image = stereogram(np.full((14, 100), 3, np.float32), texture, far_px=20)
    np.testing.assert_array_equal(image[:, 20:], image[:, :-20])
    np.testing.assert_array_equal(np.roll(image[:7, 80:], 0, axis=1), texture)


def test_wrong_input_is_named() -> None:
    with pytest.raises(ConfigError, match="repetitions are 7 px wide, 8 px to half of the 50 columns"):
        stereogram(np.zeros((4, 50), np.float32))
    with pytest.raises(ConfigError, match="repetitions are 60 px wide"):
        stereogram(np.zeros((4, 100), np.float32), far_px=60)
    with pytest.raises(ImageError, match="texture has no pixels"):
        stereogram(np.zeros((4, 100), np.float32), np.zeros((0, 4), np.uint8))

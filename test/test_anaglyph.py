# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Anaglyphs against their definition, color by color."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from stereo_depth_ros.config.stages import ANAGLYPH_FILTERS, ANAGLYPH_METHODS
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.views.anaglyph import anaglyph, anaglyph_matrix

R, G, B = range(3)


@pytest.fixture(scope="module")
def pair() -> tuple[U8, U8]:
    random = np.random.default_rng(4)
    return random.integers(0, 256, (9, 14, 3), np.uint8), random.integers(0, 256, (9, 14, 3), np.uint8)


def rgb(image: U8) -> F64:
    return image[..., ::-1].astype(np.float64)


def gray(image: U8) -> F64:
    return rgb(image) @ (0.299, 0.587, 0.114)


def red_cyan(method: str, left: U8, right: U8) -> list[F64]:
    """Red, green and blue, as the methods are described everywhere."""
    a, b = rgb(left), rgb(right)
    return {
        "true": [gray(left), np.zeros(a.shape[:2]), gray(right)],
        "gray": [gray(left), gray(right), gray(right)],
        "color": [a[..., R], b[..., G], b[..., B]],
        "half-color": [gray(left), b[..., G], b[..., B]],
        "optimized": [0.7 * a[..., G] + 0.3 * a[..., B], b[..., G], b[..., B]],
    }[method]


@pytest.mark.parametrize("method", ["true", "gray", "color", "half-color", "optimized"])
def test_red_cyan(pair: tuple[U8, U8], method: str) -> None:
    expected = np.stack(red_cyan(method, *pair), axis=-1)
    assert np.abs(rgb(anaglyph(*pair, method)) - expected).max() <= 0.51


@pytest.mark.parametrize("filters", ANAGLYPH_FILTERS)
def test_dubois_is_linear_in_light(pair: tuple[U8, U8], filters: str) -> None:
    matrix = anaglyph_matrix("dubois", filters)
    stored = np.concatenate([rgb(image) / 255 for image in pair], axis=-1)
    light = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    mixed = np.clip(light @ matrix.T, 0, 1)
    expected = 255 * np.where(mixed <= 0.0031308, 12.92 * mixed, 1.055 * mixed ** (1 / 2.4) - 0.055)
    assert np.abs(rgb(anaglyph(*pair, "dubois", filters)) - expected).max() <= 0.75


@pytest.mark.parametrize("filters", ANAGLYPH_FILTERS)
def test_dubois_keeps_white_and_separates_the_images(filters: str) -> None:
    matrix = anaglyph_matrix("dubois", filters)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=0.2)  # white of both is nearly white
    seen_left = {"red-cyan": [R], "green-magenta": [G], "amber-blue": [R, G]}[filters]
    for channel in range(3):
        mine, other = matrix[channel, :3].sum(), matrix[channel, 3:].sum()
        assert (mine > 3 * abs(other)) == (channel in seen_left)


@pytest.mark.parametrize(("method", "filters"), [*itertools.product(ANAGLYPH_METHODS[:-1], ANAGLYPH_FILTERS)])
def test_channels_belong_to_one_image(method: str, filters: str) -> None:
    matrix = anaglyph_matrix(method, filters).reshape(3, 2, 3)
    seen_left = {"red-cyan": [R], "green-magenta": [G], "amber-blue": [R, G]}[filters]
    for channel in range(3):
        mine = 0 if channel in seen_left else 1
        assert not matrix[channel, 1 - mine].any()
        dark = method == "true" and channel == G and filters != "green-magenta"
        assert matrix[channel, mine].sum() == pytest.approx(0 if dark else 1)


def test_other_filters_by_hand(pair: tuple[U8, U8]) -> None:
    left, right = pair
    found = rgb(anaglyph(left, right, "half-color", "green-magenta"))
    expected = np.stack([rgb(right)[..., R], gray(left), rgb(right)[..., B]], axis=-1)
    assert np.abs(found - expected).max() <= 0.51
    found = rgb(anaglyph(left, right, "optimized", "green-magenta"))
    own = rgb(left) @ (0.25, 0.5, 0.25)
    assert np.abs(found - np.stack([rgb(right)[..., R], own, rgb(right)[..., B]], axis=-1)).max() <= 0.51
    found = rgb(anaglyph(left, right, "optimized", "amber-blue"))
    last = 0.7 * rgb(right)[..., G] + 0.3 * rgb(right)[..., R]
    assert np.abs(found - np.stack([rgb(left)[..., R], rgb(left)[..., G], last], axis=-1)).max() <= 0.51


def test_gray_images_are_taken(pair: tuple[U8, U8]) -> None:
    left, right = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in pair)
    np.testing.assert_array_equal(anaglyph(left, right, "color"), np.stack([right, right, left], axis=-1))


def test_wrong_input_is_named(pair: tuple[U8, U8]) -> None:
    with pytest.raises(ConfigError, match="anaglyph 'purple' is not one of true, gray, color, half-color"):
        anaglyph(*pair, "purple")
    with pytest.raises(ConfigError, match="filters 'red-blue' is not one of red-cyan"):
        anaglyph(*pair, "gray", "red-blue")
    with pytest.raises(ImageError, match=r"left \(9, 14\) and right \(9, 7\) differ in size"):
        anaglyph(pair[0], pair[1][:, ::2])

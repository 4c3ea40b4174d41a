# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pattern of color stripes: every window of changes once, the same changes read back, patterns that are no code."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_depth_ros.active.one_shot.stripes import de_bruijn, read_stripes, stripe_pattern
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import U8


@pytest.mark.parametrize(("symbols", "window"), [(2, 2), (3, 4), (5, 3)])
def test_each_word_is_found_once(symbols: int, window: int) -> None:
    sequence = de_bruijn(symbols, window)
    words = {tuple(sequence[i : i + window]) for i in range(sequence.size - window + 1)}
    assert len(words) == sequence.size - window + 1 == symbols**window
    assert set(sequence.tolist()) == set(range(symbols))


@pytest.mark.parametrize(
    ("size", "stripe_px", "window", "width_px", "stripes"),
    [
        ((1280, 40), None, 3, 10, 128),
        ((1024, 7), None, 3, 8, 128),
        ((203, 5), None, 3, 2, 102),
        ((1283, 6), 4, 4, 4, 321),
    ],
)
def test_stripes_fill_the_pattern_and_are_unique(
    size: tuple[int, int], stripe_px: int | None, window: int, width_px: int, stripes: int
) -> None:
    pattern = stripe_pattern(size, stripe_px, window)
    assert pattern.shape == (size[1], size[0], 3) and pattern.dtype == np.uint8
    assert set(np.unique(pattern)) == {0, 255} and (pattern == pattern[0]).all()
    changes = np.diff(pattern[0].astype(int), axis=0).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(changes), np.arange(width_px, size[0], width_px) - 1)
    found = read_stripes(pattern)
    assert (found.size, found.window) == (size, window)
    np.testing.assert_allclose(found.edges_px, np.arange(1, stripes) * width_px - 0.5)
    np.testing.assert_array_equal(
        found.changes, np.diff(pattern[0, ::width_px].astype(int), axis=0)[: stripes - 1] // 255
    )
    words = np.lib.stride_tricks.sliding_window_view(found.changes, window, axis=0).reshape(stripes - window, -1)
    assert np.unique(words, axis=0).shape == words.shape


def test_a_pattern_made_elsewhere() -> None:
    """Resized, blurred, with levels of its own for each channel, compressed."""
    exact = read_stripes(stripe_pattern((254, 60), 2))
    foreign = cv2.resize(stripe_pattern((254, 60), 2), (1003, 71), interpolation=cv2.INTER_LINEAR)
    foreign = (np.array([20, 30, 10]) + foreign * np.array([0.6, 0.85, 0.5])).astype(np.uint8)
    foreign = cv2.imdecode(cv2.imencode(".jpg", foreign)[1], cv2.IMREAD_COLOR)
    found = read_stripes(foreign)
    np.testing.assert_array_equal(found.changes, exact.changes)
    np.testing.assert_allclose(found.edges_px, (exact.edges_px + 0.5) * 1003 / 254 - 0.5, atol=0.3)
    assert found.window == 3


def test_horizontal_stripes_and_half_a_turn() -> None:
    pattern = stripe_pattern((203, 90), 4)
    upright, lying = read_stripes(pattern), read_stripes(np.ascontiguousarray(pattern.transpose(1, 0, 2)))
    assert (upright.axis, lying.axis, lying.size, lying.length_px) == ("columns", "rows", (90, 203), 203)
    np.testing.assert_array_equal(lying.edges_px, upright.edges_px)
    np.testing.assert_array_equal(lying.changes, upright.changes)
    turned = read_stripes(np.ascontiguousarray(pattern[::-1, ::-1]))
    np.testing.assert_allclose(upright.turned().edges_px, turned.edges_px)
    np.testing.assert_array_equal(upright.turned().changes, turned.changes)


def gray_ramp() -> U8:
    return np.repeat(np.tile(np.arange(0, 240, 2, dtype=np.uint8), (9, 1))[:, :, None], 3, axis=2)


@pytest.mark.parametrize(
    ("pattern", "problem"),
    [
        (np.zeros((4, 5), np.uint8), r"uint8 \(4, 5\)"),
        (np.zeros((4, 5, 3), np.float32), "float32"),
        (np.zeros((0, 5, 3), np.uint8), "no pixels"),
        (np.zeros((4, 5, 3), np.uint8), "do not change"),
        (gray_ramp(), "do not change"),
        (np.tile(stripe_pattern((30, 20), 3), (1, 4, 1)), "at two places"),
        (np.random.default_rng(1).integers(0, 256, (40, 50, 3), np.uint8), "both its rows and its columns differ"),
    ],
)
def test_what_is_not_a_code(pattern: U8, problem: str) -> None:
    with pytest.raises(ImageError, match=problem) as error:
        read_stripes(pattern)
    assert error.value.remedy and error.value.subject == "stripe pattern"


@pytest.mark.parametrize(
    ("size", "stripe_px", "window", "setting"),
    [
        ((0, 10), None, 3, "size"),
        ((10, 20000), None, 3, "size"),
        ((1280, 720), 5, 3, "stripe_px"),
        ((1280, 720), 0, 3, "stripe_px"),
        ((1280, 720), None, 1, "window"),
    ],
)
def test_patterns_that_do_not_exist(size: tuple[int, int], stripe_px: int | None, window: int, setting: str) -> None:
    with pytest.raises(ConfigError) as error:
        stripe_pattern(size, stripe_px, window)
    assert setting in error.value.settings and error.value.remedy

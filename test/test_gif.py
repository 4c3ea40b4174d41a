# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Animated GIFs are read back by another decoder."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.views.gif import animated_gif


def decoded(data: bytes, folder: Path) -> list[U8]:
    path = folder / "animation.gif"
    path.write_bytes(data)
    video, frames = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), []
    while (found := video.read())[0]:
        frames.append(found[1])
    return frames


def test_few_colors_are_exact(tmp_path: Path) -> None:
    """Noise of 200 colors fills the table of codes many times."""
    random = np.random.default_rng(5)
    levels = np.rint(np.arange(32) * 255 / 31).astype(np.uint8)  # what 5 bits hold
    colors = levels[random.integers(0, 32, (200, 3))]
    frames = [colors[random.integers(0, 200, (61, 83))] for _ in range(3)]
    found = decoded(animated_gif(frames, 80), tmp_path)
    assert len(found) == 3
    for frame, image in zip(frames, found, strict=True):
        assert np.abs(image.astype(int) - frame).max() <= 1


@pytest.mark.parametrize("pixels", [1, 2, 253, 254, 255, 256, 257, 509, 510, 511, 512, 766, 767])
def test_lengths_at_which_codes_grow(pixels: int, tmp_path: Path) -> None:
    """No two pixels repeat, so that each adds a code; the file ends before, at and after each change of their size."""
    values = np.rint(np.arange(pixels) % 29 * 255 / 31).astype(np.uint8)
    values = np.stack([values, np.rint(np.arange(pixels) // 29 % 32 * 255 / 31).astype(np.uint8), values], axis=-1)[
        None
    ]
    (found,) = decoded(animated_gif([values], 100), tmp_path)
    assert found.shape == values.shape
    assert len(np.unique(found[0], axis=0)) == min(pixels, 256)
    assert np.abs(found.astype(int) - values).mean() < 10


def test_smooth_colors_are_near(tmp_path: Path) -> None:
    rows, columns = np.mgrid[:90, :120].astype(np.float32)
    frame = np.stack([2 * rows, 2 * columns, 250 - rows - columns], axis=-1).astype(np.uint8)
    (found,) = decoded(animated_gif([frame], 100), tmp_path)
    assert np.abs(found.astype(int) - frame).mean() < 6


def test_time_and_loop_are_written() -> None:
    data = animated_gif([np.zeros((2, 3), np.uint8), np.full((2, 3), 255, np.uint8)], 80)
    assert data[:10] == b"GIF89a\x03\x00\x02\x00"
    assert data.count(b"NETSCAPE2.0") == 1
    assert data.count(b"\x21\xf9\x04\x04\x08\x00\x00\x00") == 2


def test_frames_have_one_size() -> None:
    with pytest.raises(ImageError, match="2 frames of 2 sizes"):
        animated_gif([np.zeros((2, 3), np.uint8), np.zeros((3, 3), np.uint8)], 80)

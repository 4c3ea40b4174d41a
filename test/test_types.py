# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames and pairs: invalid input, copies, and read-only pixels."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import Frame, RectifiedPair, StereoPair

GRAY = np.arange(35, dtype=np.uint8).reshape(5, 7)
COLOR = np.arange(105, dtype=np.uint8).reshape(5, 7, 3)


@pytest.mark.parametrize(
    ("pixels", "encoding", "match"),
    [
        (COLOR, "mono8", r"^pixels: pixels have shape \(5, 7, 3\), mono8 takes \(H, W\).*: name the encoding of color"),
        (GRAY, "rgb8", r"pixels have shape \(5, 7\), rgb8 takes \(H, W, 3\)"),
        (COLOR[..., :2], "bgr8", r"pixels have shape \(5, 7, 2\), bgr8 takes \(H, W, 3\)"),
        (GRAY[..., None], "mono8", r"pixels have shape \(5, 7, 1\)"),
        (GRAY[:0], "mono8", r"of at least one pixel"),
        (GRAY.astype(np.uint16), "mono8", r"pixels are uint16, mono8 takes uint8 \(H, W\): scale deeper images"),
        (COLOR.astype(np.float32), "rgb8", r"pixels are float32, rgb8 takes uint8 \(H, W, 3\)"),
        (GRAY.tolist(), "mono8", r"pixels are list"),
        (COLOR, "RGB8", r"encoding = 'RGB8' is not one of mono8, rgb8, bgr8: name the order .* in lower case"),
    ],
)
def test_frame_refuses(pixels: Any, encoding: str, match: str) -> None:
    with pytest.raises(ImageError, match=match) as caught:
        Frame(pixels, 1, "left", encoding)
    assert caught.value.remedy
    assert caught.value.limit


def test_a_view_with_reversed_channels_is_the_image_that_it_shows() -> None:
    frame = Frame(COLOR[..., ::-1], 1, "left", "bgr8")
    assert frame.pixels.flags.c_contiguous
    np.testing.assert_array_equal(frame.pixels, COLOR[..., [2, 1, 0]])


def test_pixels_of_a_frame_cannot_be_written_and_are_not_copied() -> None:
    own = GRAY.copy()
    frame = Frame(own, 1, "left")
    assert np.shares_memory(frame.pixels, own)
    with pytest.raises(ValueError, match="read-only"):
        frame.pixels[0, 0] = 9
    own[0, 0] = 9  # the array of the caller stays writeable


def test_frames_are_equal_by_value() -> None:
    frame = Frame(GRAY, 1, "left")
    assert frame == Frame(GRAY.copy(), 1, "left")
    others = (Frame(GRAY + 1, 1, "left"), Frame(GRAY, 2, "left"), Frame(GRAY, 1, "right"), Frame(GRAY[:4], 1, "left"))
    assert all(frame != other for other in others)
    assert frame != "left"
    assert StereoPair(frame, others[2]) == StereoPair(Frame(GRAY.copy(), 1, "left"), others[2])
    assert StereoPair(frame, others[2]) != StereoPair(others[2], frame)


def test_a_pair_holds_frames() -> None:
    with pytest.raises(ImageError, match="right is ndarray, a pair holds two frames"):
        StereoPair(Frame(GRAY, 1, "left"), GRAY)  # type: ignore[arg-type]


def test_rectified_pair_refuses_sizes_that_differ() -> None:
    with pytest.raises(ImageError, match="sizes differ: left 7x5, right 7x4, left_color 7x5"):
        RectifiedPair(GRAY, GRAY[:4], COLOR, "rgb8")
    with pytest.raises(ImageError, match="right: pixels are int16"):
        RectifiedPair(GRAY, GRAY.astype(np.int16), COLOR, "rgb8")  # type: ignore[arg-type]
    with pytest.raises(ImageError, match=r"left_color: pixels have shape \(5, 7, 3\), mono8"):
        RectifiedPair(GRAY, GRAY, COLOR, "mono8")


def test_rectified_pairs_are_equal_by_value() -> None:
    pair = RectifiedPair(GRAY, GRAY + 1, COLOR, "rgb8")
    assert pair == RectifiedPair(GRAY.copy(), GRAY + 1, COLOR.copy(), "rgb8")
    assert pair != RectifiedPair(GRAY, GRAY, COLOR, "rgb8")
    assert pair != RectifiedPair(GRAY, GRAY + 1, COLOR, "bgr8")


@pytest.mark.parametrize("encoding", [["rgb8"], {"rgb8": 3}])
def test_frame_refuses_an_encoding_that_is_not_text(encoding: Any) -> None:
    with pytest.raises(ImageError, match=r"encoding = .* is not one of mono8, rgb8, bgr8"):
        Frame(COLOR, 1, "left", encoding)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_copies_of_frames_and_pairs_are_equal_and_read_only(duplicate: Callable[[Any], Any]) -> None:
    frame = Frame(COLOR, 1, "left", "rgb8")
    rectified = RectifiedPair(GRAY, GRAY + 1, COLOR, "bgr8")
    assert duplicate(frame) == frame and duplicate(rectified) == rectified
    assert duplicate(StereoPair(frame, frame)) == StereoPair(frame, frame)
    assert not duplicate(frame).pixels.flags.writeable
    copied = duplicate(rectified)
    assert not any(getattr(copied, name).flags.writeable for name in ("left", "right", "left_color"))


def test_gray_of_a_frame_is_checked_compared_and_kept_by_copies() -> None:
    frame = Frame(COLOR, 1, "left", "rgb8", GRAY.copy())
    assert frame.gray is not None and not frame.gray.flags.writeable
    assert frame == Frame(COLOR, 1, "left", "rgb8", GRAY) == copy.deepcopy(frame)
    assert frame not in (Frame(COLOR, 1, "left", "rgb8"), Frame(COLOR, 1, "left", "rgb8", GRAY + 1))
    with pytest.raises(ImageError, match=r"^gray: gray has shape .*, the pixels have"):
        Frame(COLOR, 1, "left", "rgb8", GRAY[1:])
    with pytest.raises(ImageError, match=r"^gray: pixels are float64, mono8 takes uint8"):
        Frame(COLOR, 1, "left", "rgb8", GRAY.astype(float))  # type: ignore[arg-type]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views between the cameras: shifted planes exactly, rendered and photographed views in between, and wrong input."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered_views import psnr, rendered_views

from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.views.interpolation import dense_disparity, interpolate_view, right_disparity

BEHIND_PX, FRONT_PX = 4, 12


def smooth_texture(width: int, height: int, seed: int) -> U8:
    noise = np.random.default_rng(seed).uniform(0, 255, (height, width, 3)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 10, 245, cv2.NORM_MINMAX).astype(np.uint8)


def two_planes(position: float, width: int = 120, height: int = 40) -> tuple[U8, F32]:
    """The image of a camera that sees a square at 12 px before a wall at 4 px, and its disparities."""
    wall, square = smooth_texture(width + 80, height, 1), smooth_texture(30, height, 2)
    first = 40 - round(position * BEHIND_PX)
    image = np.ascontiguousarray(wall[:, 80 - first : 80 - first + width])
    disparity_px = np.full((height, width), BEHIND_PX, np.float32)
    at = 50 - round(position * FRONT_PX)
    image[8:32, at : at + 30], disparity_px[8:32, at : at + 30] = square[8:32], FRONT_PX
    return image, disparity_px


def test_plane_is_shifted() -> None:
    left = smooth_texture(90, 20, 3)
    right = np.roll(left, -8, axis=1)
    disparity_px = np.full((20, 90), 8, np.float32)
    for position, shift in ((-0.5, -4), (0.0, 0), (0.25, 2), (0.5, 4), (1.0, 8), (1.5, 12)):
        view = interpolate_view(left, right, disparity_px, position)
        np.testing.assert_array_equal(view[:, 14:-14], np.roll(left, -shift, axis=1)[:, 14:-14])


def test_half_a_pixel_is_cubic() -> None:
    columns = np.arange(60)
    left = np.tile((0.05 * (columns - 30.0) ** 2 + 100).round().astype(np.uint8), (4, 1))
    view = interpolate_view(left, left, np.full((4, 60), 1, np.float32), 0.5, np.full((4, 60), np.nan, np.float32))
    both = left[0].astype(float)
    half = (-both[:-3] + 9 * both[1:-2] + 9 * both[2:-1] - both[3:]) / 16  # between the columns 1 and 2, and so on
    left_part, right_part = half[1:], both[2:-2]  # x + 0.5 of the left image, x of the right one, whose disparity is 0
    expected = 0.5 * (left_part + right_part)
    assert np.abs(view[0, 2:-2] - expected[: len(view[0, 2:-2])]).max() <= 1


@pytest.mark.parametrize("position", [-0.5, 0.25, 0.5, 0.75, 1.5])
def test_foreground_covers_and_uncovers_the_background(position: float) -> None:
    (left, disparity_px), (right, right_px), (truth, _) = two_planes(0), two_planes(1), two_planes(position)
    known = np.ones(truth.shape[:2], bool)
    edges = 50 - round(position * FRONT_PX) + np.array([0, 30])
    for edge in edges:
        known[:, edge - 2 : edge + 2] = False  # split into foreground and background by their neighbors
    if position < 0:  # neither camera sees what is behind the square
        known[:, edges[0] - 6 : edges[0]] = False
    if position > 1:
        known[:, edges[1] : edges[1] + 6] = False
    known[:, :12] = known[:, -12:] = False
    for given in (None, right_px):
        view = interpolate_view(left, right, disparity_px, position, given)
        assert np.abs(view.astype(int) - truth)[known].max() <= 1


def test_holes_continue_the_background() -> None:
    """Left of the square no camera sees the wall from -0.5: it is not the color of the square."""
    left = np.full((9, 80), 60, np.uint8)
    left[:, 30:50] = 200
    disparity_px = np.where(left == 200, np.float32(FRONT_PX), np.float32(BEHIND_PX))
    right = np.full((9, 80), 60, np.uint8)
    right[:, 18:38] = 200
    view = interpolate_view(left, right, disparity_px, -0.5)
    expected = np.full((9, 80), 60, np.uint8)
    expected[:, 36:56] = 200
    np.testing.assert_array_equal(view, expected)


def test_mixed_pixels_of_an_edge_stay_mixed_and_move_with_the_foreground() -> None:
    left = np.full((5, 80), 40, np.uint8)
    left[:, 30:50] = 240
    left[:, 29] = 90  # a quarter of the foreground
    disparity_px = np.full((5, 80), BEHIND_PX, np.float32)
    disparity_px[:, 30:50] = FRONT_PX
    right = np.full((5, 80), 40, np.uint8)
    right[:, 18:38], right[:, 17] = 240, 90
    view = interpolate_view(left, right, disparity_px, 0.5)
    np.testing.assert_array_equal(view[:, 22:26], np.tile(np.uint8([40, 90, 240, 240]), (5, 1)))


def test_right_disparities_follow_from_the_left_ones() -> None:
    left_px, right_px = two_planes(0)[1], two_planes(1)[1]
    np.testing.assert_array_equal(right_disparity(left_px)[:, 12:-12], right_px[:, 12:-12])


def test_invalid_disparities_are_those_of_the_background() -> None:
    disparity_px = np.array([[np.nan, 5, np.nan, np.inf, 3], [np.nan] * 5], np.float32)
    np.testing.assert_array_equal(dense_disparity(disparity_px), [[5, 5, 3, 3, 3]] * 2)
    np.testing.assert_array_equal(dense_disparity(np.full((2, 3), np.nan, np.float32)), np.zeros((2, 3)))


def test_without_disparities_the_images_are_blended() -> None:
    left, right = smooth_texture(40, 6, 5), smooth_texture(40, 6, 6)
    view = interpolate_view(left, right, np.full((6, 40), np.nan, np.float32), 0.25)
    assert np.abs(view - (0.75 * left + 0.25 * right)).max() <= 0.5 + 1e-3


def test_gray_is_a_color_of_equal_channels() -> None:
    left, disparity_px = two_planes(0)
    right = two_planes(1)[0]
    gray = interpolate_view(left[..., 1], right[..., 1], disparity_px, 0.4)
    colored = interpolate_view(*(np.repeat(each[..., 1:2], 3, 2) for each in (left, right)), disparity_px, 0.4)
    assert gray.shape == (40, 120)
    assert np.abs(colored.astype(int) - gray[..., None]).max() <= 1


@pytest.mark.parametrize(("position", "least_db"), [(0.25, 34.0), (0.5, 34.0), (0.7, 34.0), (-0.3, 29.0), (1.3, 29.0)])
def test_rendered_view_in_between(position: float, least_db: float) -> None:
    room = rendered_views()
    truth, view = room.at(position), interpolate_view(room.left, room.right, room.disparity_px, position)
    share = min(max(position, 0.0), 1.0)
    blended = np.rint((1 - share) * room.left + share * room.right).astype(np.uint8)
    assert psnr(view, truth) >= least_db
    assert psnr(view, truth) >= psnr(blended, truth) + 5


def test_views_of_the_cameras_are_their_images() -> None:
    room = rendered_views()
    for position, image in ((0.0, room.left), (1.0, room.right)):
        assert psnr(interpolate_view(room.left, room.right, room.disparity_px, position), image) > 38


@pytest.mark.real_data
def test_photographed_view_in_between(stereo_data: Path) -> None:
    folder = stereo_data / "middlebury2001" / "tsukuba"
    left, truth, right = (cv2.imread(str(folder / f"scene1.row3.col{number}.ppm")) for number in (3, 4, 5))
    gray = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (left, right)]
    disparity_px = create_matcher("sgm", num_disparities=32).match(*gray).disparity_px
    blended = cv2.addWeighted(left, 0.5, right, 0.5, 0)
    view = interpolate_view(left, right, disparity_px, 0.5)
    assert psnr(view, truth) >= 30
    assert psnr(view, truth) >= psnr(blended, truth) + 5


@pytest.mark.real_data
def test_images_of_a_pair_agree_half_way(stereo_data: Path) -> None:
    """Without an image from in between: what each camera shows alone at 0.5 is nearly the same."""
    folder = stereo_data / "middlebury2001" / "venus"
    left, right = (cv2.imread(str(folder / name)) for name in ("im2.ppm", "im6.ppm"))
    truth_px = cv2.imread(str(folder / "disp2.pgm"), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 8
    from_left = interpolate_view(left, np.zeros_like(right), truth_px, 0.0)
    assert psnr(from_left, left) > 38
    from_right = interpolate_view(left, right, truth_px, 1.0)
    assert psnr(from_right, right) > psnr(left, right) + 15


def test_wrong_input_is_named() -> None:
    image, disparity_px = np.zeros((6, 8), np.uint8), np.zeros((6, 8), np.float32)
    with pytest.raises(ConfigError, match=r"position 1\.6 is outside -0\.5\.\.1\.5: 0 is the left camera"):
        interpolate_view(image, image, disparity_px, 1.6)
    with pytest.raises(ConfigError, match="position nan"):
        interpolate_view(image, image, disparity_px, float("nan"))
    for wrong in (
        (image, image[:, :4], disparity_px),
        (image, np.zeros((6, 8, 3), np.uint8), disparity_px),
        (image, image, disparity_px[:3]),
    ):
        with pytest.raises(ImageError, match=r"shapes differ: left \(6, 8\), right .*: use two images of one kind"):
            interpolate_view(*wrong, 0.5)

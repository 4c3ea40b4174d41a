# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Colors of disparity and depth against OpenCV's map; lightness grows evenly, invalid pixels are gray."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.views.color_maps import INVALID, depth_color, disparity_color


def test_colors_are_those_of_the_map() -> None:
    disparity_px = np.array([[8, 40, 72, -3, 90, np.nan, np.inf]], np.float32)
    colors = disparity_color(disparity_px, 8, 72)
    levels = np.array([[0, 128, 255, 0, 255]], np.uint8)
    np.testing.assert_array_equal(colors[:, :5], cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS))
    assert (colors[0, 5:] == INVALID).all()


def test_lightness_grows_evenly() -> None:
    ramp = np.linspace(0, 1, 64, dtype=np.float32)[None]
    lab = cv2.cvtColor(disparity_color(ramp, 0, 1).astype(np.float32) / 255, cv2.COLOR_BGR2Lab)[0]
    steps = np.diff(lab[:, 0])
    assert steps.min() > 0.5 * steps.mean() and steps.max() < 1.6 * steps.mean()


def test_near_is_light_and_the_range_is_that_of_the_image_or_given() -> None:
    depth_m = np.linspace(2, 6, 401, dtype=np.float32)[None]
    depth_m[0, 7] = np.nan
    found = depth_color(depth_m)
    assert (found[0, 7] == INVALID).all()
    light, dark = cv2.applyColorMap(np.array([[255, 0]], np.uint8), cv2.COLORMAP_VIRIDIS)[0]
    np.testing.assert_array_equal(found[0, 0], light)
    np.testing.assert_array_equal(found[0, -1], dark)
    given = depth_color(depth_m, 1.0, 10.0)
    level = np.rint(255 * (10 - depth_m[0, 100]) / 9)
    expected = cv2.applyColorMap(np.array([[level]], np.uint8), cv2.COLORMAP_VIRIDIS)[0, 0]
    np.testing.assert_array_equal(given[0, 100], expected)


def test_nothing_valid_and_equal_values() -> None:
    assert (depth_color(np.full((3, 4), np.nan, np.float32)) == INVALID).all()
    assert depth_color(np.full((3, 4), 2, np.float32), legend=True).shape == (3, 96, 3)


def test_legend_is_beside_the_image() -> None:
    disparity_px = np.tile(np.linspace(0, 63, 160, dtype=np.float32), (120, 1))
    with_legend = disparity_color(disparity_px, 0, 63, legend=True)
    np.testing.assert_array_equal(with_legend[:, :160], disparity_color(disparity_px, 0, 63))
    scale = with_legend[:, 160 + 12].astype(int)
    np.testing.assert_array_equal(scale[[0, -1]], with_legend[0, [159, 0]])
    assert with_legend.shape == (120, 252, 3)

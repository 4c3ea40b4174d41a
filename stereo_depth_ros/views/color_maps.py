# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Disparity and depth as colors of a perceptually uniform map, near is light; invalid pixels are gray."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.plots.drawing import canvas, draw_color_bar, round_ticks

__all__ = ["INVALID", "depth_color", "disparity_color"]

INVALID = 96  # gray level of invalid pixels, in all channels; viridis has no gray
_MAP = cv2.COLORMAP_VIRIDIS  # S. van der Walt, N. Smith 2015
_LEGEND, _MARGIN, _TICK_PX = 92, 8, 40


def disparity_color(disparity_px: F32, low_px: float, high_px: float, *, legend: bool = False) -> U8:
    """Colors linear in the disparity.

    Args:
        disparity_px: float32 (H, W), px, NaN where invalid.
        low_px, high_px: disparities with the darkest and the lightest color; others are cut to them.
        legend: add a scale in pixels on the right.

    Returns:
        uint8 (H, W, 3) BGR; 92 columns more with a legend.
    """
    colors = _colored(disparity_px, low_px, high_px)
    return _with_legend(colors, low_px, high_px, "px") if legend else colors


def depth_color(depth_m: F32, near_m: float = 0.0, far_m: float = 0.0, *, legend: bool = False) -> U8:
    """Colors linear in the depth.

    Args:
        depth_m: float32 (H, W), meters, NaN where invalid.
        near_m, far_m: depths with the lightest and the darkest color; 0 is the 1st or the 99th percentile.
        legend: add a scale in meters on the right.

    Returns:
        uint8 (H, W, 3) BGR; 92 columns more with a legend.
    """
    near_m, far_m = _depth_range(depth_m, near_m, far_m)
    colors = _colored(depth_m, far_m, near_m)
    return _with_legend(colors, far_m, near_m, "m") if legend else colors


def _depth_range(depth_m: F32, near_m: float, far_m: float) -> tuple[float, float]:
    if not (near_m and far_m):
        valid = depth_m[np.isfinite(depth_m)]
        low, high = (float(each) for each in np.percentile(valid, (1, 99))) if valid.size else (0.0, 1.0)
        near_m, far_m = near_m or low, far_m or high
    return near_m, far_m


@functools.cache
def _levels() -> U8:
    """The map: uint8 (256, 3), BGR."""
    return np.asarray(cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], _MAP)[:, 0], np.uint8)


def _colored(values: F32, dark: float, light: float) -> U8:
    out = np.empty((*values.shape, 3), np.uint8)
    span = light - dark if light != dark else 1.0
    run_bands(_color_rows, len(out), values, np.float32(dark), np.float32(255 / span), _levels(), out)
    return out


@compiled(
    "void(int64, int64, Array(float32, 2, 'C', readonly=True), float32, float32, uint8[:, ::1], uint8[:, :, ::1])"
)
def _color_rows(
    first: int, last: int, values: F32, dark: np.float32, per_unit: np.float32, levels: U8, out: U8
) -> None:
    for y in range(first, last):
        for x in range(values.shape[1]):
            share = (values[y, x] - dark) * per_unit
            if np.isfinite(share):
                level = int(min(max(share, np.float32(0)), np.float32(255)) + np.float32(0.5))
                for c in range(3):
                    out[y, x, c] = levels[level, c]
            else:
                for c in range(3):
                    out[y, x, c] = INVALID


def _with_legend(colors: U8, dark: float, light: float, unit: str) -> U8:
    height, width = colors.shape[:2]
    image = canvas(width + _LEGEND, height)
    image[:, :width] = colors
    low, high = sorted((dark, light))
    ticks = round_ticks(low, high, max(2, height // _TICK_PX)) if high > low else [low]
    places = [((tick - dark) / (light - dark) if light != dark else 0.5, f"{tick:g} {unit}") for tick in ticks]
    draw_color_bar(image, width + _MARGIN, 0, height, places, _MAP)
    return image

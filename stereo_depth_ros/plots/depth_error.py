# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An image of how the depth error of a rig grows with the distance, for several baselines."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.plots.drawing import FAINT, TEXT, Color, canvas, draw_text, round_ticks

__all__ = ["depth_error_plot"]

_WIDTH, _HEIGHT = 820, 480
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 24, 70, 56
_SHIFT = 4  # bits of a pixel's fraction in which lines are drawn
_GRID: Color = (52, 46, 42)
_LINES: tuple[Color, ...] = ((232, 197, 158), (72, 150, 253), (120, 200, 120))  # BGR


def depth_error_plot(
    depth_m: F64, sigma_m: Mapping[str, F64], nearest_m: Mapping[str, float], max_error: float, title: str
) -> U8:
    """Standard deviation of the depth over the depth as a uint8 (H', W', 3) BGR image.

    Args:
        depth_m: float64 (n,), from smallest to largest: the axis begins at 0 and ends at the last one.
        sigma_m: float64 (n,) for each name, at most three names, meters.
        nearest_m: for each name where its line begins.
        max_error: share of the depth that is still of use; drawn as a straight line, the axis ends a bit above it.
        title: one line over it.
    """
    image = canvas(_WIDTH, _HEIGHT)
    draw_text(image, title, (_LEFT, 28), 0.6)
    last_m = float(depth_m[-1])
    high_m = 1.5 * max_error * last_m
    _draw_axes(image, last_m, high_m)
    x = _LEFT
    for (name, values), color in zip(sigma_m.items(), _LINES, strict=False):
        seen = (depth_m >= nearest_m[name]) & (values <= high_m)
        _draw_line(image, depth_m[seen] / last_m, values[seen] / high_m, color)
        draw_text(image, name, (x, 56), color=color)
        x += 30 + 8 * len(name)
    _draw_line(image, np.array([0.0, 1.0]), np.array([0.0, 1 / 1.5]), TEXT)
    draw_text(image, f"{100 * max_error:g} % of the distance", (x, 56), color=TEXT)
    return image


def _draw_axes(image: U8, last_m: float, high_m: float) -> None:
    for tick in round_ticks(0, high_m, 6):
        y = round(_HEIGHT - _BOTTOM - tick / high_m * (_HEIGHT - _TOP - _BOTTOM))
        cv2.line(image, (_LEFT, y), (_WIDTH - _RIGHT, y), _GRID, 1)
        draw_text(image, f"{tick:g}", (_LEFT - 8, y + 5), color=FAINT, right=True)
    for tick in round_ticks(0, last_m, 10):
        x = round(_LEFT + tick / last_m * (_WIDTH - _LEFT - _RIGHT))
        cv2.line(image, (x, _TOP), (x, _HEIGHT - _BOTTOM), _GRID, 1)
        draw_text(image, f"{tick:g}", (x + 4 * len(f"{tick:g}"), _HEIGHT - _BOTTOM + 18), color=FAINT, right=True)
    caption = "standard deviation of the depth, meters, over the distance, meters"
    draw_text(image, caption, (_LEFT, _HEIGHT - 14), color=FAINT)


def _draw_line(image: U8, x: F64, y: F64, color: Color) -> None:
    """A line through points, both coordinates as shares of their axis."""
    columns = _LEFT + x * (_WIDTH - _LEFT - _RIGHT)
    rows = _HEIGHT - _BOTTOM - y * (_HEIGHT - _TOP - _BOTTOM)
    points = (np.stack((columns, rows), axis=1) * (1 << _SHIFT)).round().astype(np.int32)
    cv2.polylines(image, [points], False, color, 2, cv2.LINE_AA, _SHIFT)

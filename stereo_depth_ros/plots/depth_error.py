# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots the depth error of a rig over the distance, for several baselines."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.plots.drawing import TEXT, Axes, Color, canvas, draw_text

__all__ = ["depth_error_plot"]

_WIDTH, _HEIGHT = 820, 480
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 24, 70, 56
_LINES: tuple[Color, ...] = ((232, 197, 158), (72, 150, 253), (120, 200, 120))  # BGR


def depth_error_plot(
    depth_m: F64, sigma_m: Mapping[str, F64], nearest_m: Mapping[str, float], max_error: float, title: str
) -> U8:
    """Standard deviation of the depth over the depth as a uint8 (H', W', 3) BGR image.

    Args:
        depth_m: float64 (n,), ascending, meters; the axis runs from 0 to the last one.
        sigma_m: float64 (n,) for each name, at most three names, meters.
        nearest_m: for each name the depth where its line begins, meters.
        max_error: largest useful error as a share of the depth; drawn as a straight line, the axis ends above it.
        title: one line above.
    """
    image = canvas(_WIDTH, _HEIGHT)
    draw_text(image, title, (_LEFT, 28), 0.6)
    last_m = float(depth_m[-1])
    high_m = 1.5 * max_error * last_m
    axes = Axes(image, _LEFT, _TOP, _WIDTH - _RIGHT, _HEIGHT - _BOTTOM, last_m, high_m)
    axes.draw_grid("standard deviation of the depth, meters, over the distance, meters")
    x = _LEFT
    for (name, values), color in zip(sigma_m.items(), _LINES, strict=False):
        seen = (depth_m >= nearest_m[name]) & (values <= high_m)
        axes.draw_line(depth_m[seen], values[seen], color)
        draw_text(image, name, (x, 56), color=color)
        x += 30 + 8 * len(name)
    axes.draw_line(np.array([0.0, last_m]), np.array([0.0, max_error * last_m]), TEXT)
    draw_text(image, f"{100 * max_error:g} % of the distance", (x, 56), color=TEXT)
    return image

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots a sparsification curve: the error of the pixels kept over the share of pixels kept."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.plots.drawing import FAINT, Axes, Color, canvas, draw_text

__all__ = ["curve_plot"]

_WIDTH, _HEIGHT = 720, 420
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 24, 62, 52
_POINTS = 200  # number of points of a line
_OURS: Color = (72, 150, 253)
_ORACLE: Color = (180, 160, 49)
_HEADROOM = 1.15  # the axis ends above the highest point of the curves


def curve_plot(error: F64, oracle: F64, density: float, title: str, unit: str) -> U8:
    """Error over coverage as a uint8 (H', W', 3) BGR image: by confidence, in random order, in the best order.

    Args:
        error, oracle: float64 (n,), mean error of the first k of n pixels, k = 1..n; see ``SparsificationCurve``.
        density: the n pixels as a share of the truth pixels, 0..1: where the coverage ends.
        title: one line above.
        unit: unit of the error.
    """
    image = canvas(_WIDTH, _HEIGHT)
    # the mean of the first few pixels is noise
    shown = np.linspace(error.size // 100, error.size - 1, _POINTS).round().astype(np.int64)
    high = _HEADROOM * max(float(error[shown].max()), 1e-6)
    draw_text(image, title, (_LEFT, 26), 0.6)
    axes = Axes(image, _LEFT, _TOP, _WIDTH - _RIGHT, _HEIGHT - _BOTTOM, 100.0, high)
    axes.draw_grid(f"{unit}, over the percentage of truth pixels kept")
    coverage = 100 * density * (shown + 1) / error.size
    lines: tuple[tuple[str, Color, F64], ...] = (
        ("random order", FAINT, np.full(shown.size, error[-1])),
        ("best order", _ORACLE, oracle[shown]),
        ("by confidence", _OURS, error[shown]),
    )
    for number, (name, color, values) in enumerate(lines):
        axes.draw_line(coverage, values, color)
        draw_text(image, name, (_LEFT + 130 * number, 50), color=color)
    return image

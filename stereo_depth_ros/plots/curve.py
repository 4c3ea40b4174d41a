# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An image of what a confidence is worth: the error of the pixels that are kept, over the share that is kept."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.plots.drawing import FAINT, Color, canvas, draw_text, round_ticks

__all__ = ["curve_plot"]

_WIDTH, _HEIGHT = 720, 420
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 24, 62, 52
_POINTS = 200  # of a line
_SHIFT = 4  # bits of a pixel's fraction in which lines are drawn
_OURS: Color = (72, 150, 253)
_ORACLE: Color = (180, 160, 49)
_GRID: Color = (52, 46, 42)
_AXIS_SHARE = 1.15  # the axis ends above the highest point of the curves


def curve_plot(error: F64, oracle: F64, density: float, title: str, unit: str) -> U8:
    """Error over coverage as a uint8 (H', W', 3) BGR image: by confidence, in random order, in the best order.

    Args:
        error, oracle: float64 (n,), mean error of the k first of n pixels, k = 1..n; see ``SparsificationCurve``.
        density: share of truth pixels that the n are, 0..1: where the coverage ends.
        title: one line over it.
        unit: what the error is.
    """
    image = canvas(_WIDTH, _HEIGHT)
    # the first few pixels say nothing, and their mean may be anything
    shown = np.linspace(error.size // 100, error.size - 1, _POINTS).round().astype(np.int64)
    high = _AXIS_SHARE * max(float(error[shown].max()), 1e-6)
    draw_text(image, title, (_LEFT, 26), 0.6)
    _draw_axes(image, high, unit)
    coverage = 100 * density * (shown + 1) / error.size
    lines: tuple[tuple[str, Color, F64], ...] = (
        ("random order", FAINT, np.full(shown.size, error[-1])),
        ("best order", _ORACLE, oracle[shown]),
        ("by confidence", _OURS, error[shown]),
    )
    for number, (name, color, values) in enumerate(lines):
        points = np.stack([_x(coverage), _y(values, high)], axis=-1) * (1 << _SHIFT)
        cv2.polylines(image, [points.round().astype(np.int32)], False, color, 2, cv2.LINE_AA, _SHIFT)
        draw_text(image, name, (_LEFT + 130 * number, 50), color=color)
    return image


def _draw_axes(image: U8, high: float, unit: str) -> None:
    for tick in round_ticks(0, high, 6):
        y = round(float(_y(np.float64(tick), high)))
        cv2.line(image, (_LEFT, y), (_WIDTH - _RIGHT, y), _GRID, 1)
        draw_text(image, f"{tick:g}", (_LEFT - 8, y + 5), color=FAINT, right=True)
    for tick in round_ticks(0, 100, 10):
        x = round(float(_x(np.float64(tick))))
        cv2.line(image, (x, _TOP), (x, _HEIGHT - _BOTTOM), _GRID, 1)
        draw_text(image, f"{tick:g}", (x + 4 * len(f"{tick:g}"), _HEIGHT - _BOTTOM + 18), color=FAINT, right=True)
    draw_text(image, f"{unit}, over the percentage of truth pixels that is kept", (_LEFT, _HEIGHT - 12), color=FAINT)


def _x(coverage: F64 | np.float64) -> F64:
    return np.asarray(_LEFT + coverage / 100 * (_WIDTH - _LEFT - _RIGHT), np.float64)


def _y(values: F64 | np.float64, high: float) -> F64:
    return np.asarray(_HEIGHT - _BOTTOM - values / high * (_HEIGHT - _TOP - _BOTTOM), np.float64)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots disparities beside their truth: left image, truth, disparities and the error of each pixel, with legends."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.plots.drawing import (
    FAINT,
    Color,
    canvas,
    draw_bar,
    draw_color_bar,
    draw_text,
    enlarged,
    round_ticks,
    turbo,
)

__all__ = ["error_colors", "error_plot"]

_PANEL_WIDTH = 560
_MARGIN, _TITLE, _CAPTION, _LEGEND = 16, 36, 30, 150
_LABEL_X = 27  # of the error legend, from its bars
_NO_TRUTH: Color = (60, 54, 50)
_NO_DISPARITY: Color = (0, 0, 0)
# blue to red (BGR), apart in lightness too
_CLASSES: tuple[tuple[float, str, Color], ...] = (
    (0.5, "up to 0.5 px", (180, 119, 49)),
    (1.0, "0.5 to 1 px", (232, 197, 158)),
    (2.0, "1 to 2 px", (170, 230, 255)),
    (4.0, "2 to 4 px", (72, 150, 253)),
    (np.inf, "above 4 px", (40, 30, 190)),
)


def error_plot(left: U8, truth_px: F32, disparity_px: F32, title: str, caption: str) -> U8:
    """Two by two panels as a uint8 (H', W', 3) BGR image.

    Truth and disparities share one turbo scale from the smallest to the largest true disparity; unknown and invalid
    pixels are black. The error has a color per class.

    Args:
        left: uint8 (H, W) or (H, W, 3) BGR, the rectified left image.
        truth_px: float32 (H, W), px, NaN where unknown.
        disparity_px: float32 (H, W), px, NaN where invalid.
        title: one line above.
        caption: one line below the error.

    Raises:
        ImageError: the three have different sizes.
    """
    if not left.shape[:2] == truth_px.shape == disparity_px.shape:
        raise ImageError(
            f"left image {left.shape[:2]}, truth {truth_px.shape} and disparity {disparity_px.shape} differ in size",
            value=(left.shape[:2], truth_px.shape, disparity_px.shape),
            limit="one size",
            remedy="use images of one pair",
        )
    low, high = _span(truth_px)
    panels = (
        (left, "left image"),
        (_disparity_colors(truth_px, low, high), f"truth, known of {_share(truth_px):.1f} % of the pixels"),
        (_disparity_colors(disparity_px, low, high), f"found, {_share(disparity_px):.1f} % of the pixels"),
        (error_colors(truth_px, disparity_px), caption),
    )
    height, width = enlarged(left, _PANEL_WIDTH).shape[:2]
    image = canvas(2 * width + 3 * _MARGIN + _LEGEND, _TITLE + _MARGIN + 2 * (height + _CAPTION))
    for index, (panel, text) in enumerate(panels):
        x = _MARGIN + index % 2 * (width + _MARGIN)
        y = _TITLE + _MARGIN // 2 + index // 2 * (height + _CAPTION)
        image[y : y + height, x : x + width] = enlarged(panel, _PANEL_WIDTH)
        draw_text(image, text, (x, y + height + 20), color=FAINT)
    draw_text(image, title, (_MARGIN, 28), 0.65)
    x = 2 * width + 3 * _MARGIN
    ticks = round_ticks(low, high, max(2, height // 50))
    places = [((tick - low) / (high - low), f"{tick:g} px") for tick in ticks]
    draw_color_bar(image, x, _TITLE + _MARGIN // 2, height, places)
    _draw_error_legend(image, x, _TITLE + _MARGIN // 2 + height + _CAPTION)
    return image


def error_colors(truth_px: F32, disparity_px: F32) -> U8:
    """The class of each pixel's absolute error as a color, uint8 (H, W, 3) BGR."""
    error = np.abs(disparity_px - truth_px)
    colors = np.empty((*truth_px.shape, 3), np.uint8)
    colors[:] = _NO_DISPARITY
    for limit, _, color in reversed(_CLASSES):
        colors[error <= limit] = color
    colors[~np.isfinite(truth_px)] = _NO_TRUTH
    return colors


def _span(truth_px: F32) -> tuple[float, float]:
    known = truth_px[np.isfinite(truth_px)]
    if not known.size:
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    return (low, high) if high - low > 0.5 else (low - 0.5, high + 0.5)


def _share(values: F32) -> float:
    return 100 * np.count_nonzero(np.isfinite(values)) / values.size


def _disparity_colors(disparity_px: F32, low: float, high: float) -> U8:
    known_px = np.where(np.isfinite(disparity_px), disparity_px, np.float32(np.nan))
    return turbo(np.clip((known_px - low) / (high - low), 0, 1))


def _draw_error_legend(image: U8, x: int, top: int) -> None:
    classes = [(text, color) for _, text, color in _CLASSES]
    for row, (text, color) in enumerate([*classes, ("no disparity", _NO_DISPARITY), ("no truth", _NO_TRUTH)]):
        y = top + 24 * row
        draw_bar(image, (x, y), color)
        draw_text(image, text, (x + _LABEL_X, y + 13))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots the views of a calibration: the corners in both cameras, and the reprojection error of each view."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.calibration.calibration_result import StereoCalibration, ViewErrors
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.plots.drawing import FAINT, TEXT, Color, canvas, draw_text, round_ticks, turbo

__all__ = ["coverage_plot"]

_PANEL_WIDTH = 560
_MARGIN, _TITLE, _CAPTION, _BARS, _AXIS = 16, 36, 30, 150, 44
_PANEL: Color = (48, 42, 38)
_LEFT, _RIGHT = (232, 170, 90), (90, 170, 250)  # BGR; apart in lightness and for the color-blind


def coverage_plot(
    calibration: StereoCalibration,
    sides: tuple[str, str] = ("left", "right"),
    right_size: tuple[int, int] | None = None,
) -> U8:
    """The corners of all views used in both images, and the error of each view, uint8 (H', W', 3) BGR.

    A corner has the color of its view's error: turbo from 0 to the largest error of the views.

    Args:
        calibration: of two cameras, or of a camera and a projector.
        sides: their names.
        right_size: width, height of the image of the right one where its corners are not in one of the left one's size.
    """
    sizes = calibration.size, right_size or calibration.size
    scales = [_PANEL_WIDTH / width for width, _ in sizes]
    heights = [round(scale * height) for scale, (_, height) in zip(scales, sizes, strict=True)]
    panel_height = max(heights)
    top, bars_top = _TITLE + _MARGIN // 2, _TITLE + _MARGIN // 2 + panel_height + _CAPTION + _MARGIN
    image = canvas(2 * _PANEL_WIDTH + 3 * _MARGIN, bars_top + _BARS + _AXIS)
    largest = max(max(view.rms_left, view.rms_right) for view in calibration.views)
    for number, (side, color) in enumerate(zip(sides, (_LEFT, _RIGHT), strict=True)):
        x, scale = _MARGIN + number * (_PANEL_WIDTH + _MARGIN), scales[number]
        panel = image[top : top + heights[number], x : x + _PANEL_WIDTH]
        panel[:] = _PANEL
        for view in calibration.views:
            points, rms = (view.left_px, view.rms_left) if number == 0 else (view.right_px, view.rms_right)
            _draw_corners(panel, scale * (points + 0.5) - 0.5, _error_color(rms / largest))
        camera = calibration.left if number == 0 else calibration.right
        caption = f"{side}: {len(calibration.views)} views, rms {camera.rms_px:.3f} px"
        draw_text(image, caption, (x, top + panel_height + 20), color=color)
    _draw_bars(image[bars_top:, _MARGIN:-_MARGIN], calibration.views, largest)
    title = (
        f"{calibration.model}, baseline {1e3 * calibration.baseline_m:.2f} mm, rms {calibration.rms_stereo_px:.3f} px, "
        f"rows {calibration.epipolar_rms_px:.3f} px"
    )
    draw_text(image, title, (_MARGIN, 28), 0.65)
    return image


def _error_color(share: float) -> Color:
    blue, green, red = (int(value) for value in turbo(np.array([[min(share, 1.0)]], np.float32))[0, 0])
    return blue, green, red


def _draw_corners(panel: U8, points: F64, color: Color) -> None:
    """The corners and their convex hull."""
    sixteenths = np.round(points * 16).astype(np.int32)
    outline = cv2.convexHull(sixteenths)
    cv2.polylines(panel, [outline], True, FAINT, 1, cv2.LINE_AA, shift=4)
    for x, y in sixteenths:
        cv2.circle(panel, (int(x), int(y)), 2 * 16, color, -1, cv2.LINE_AA, shift=4)


def _draw_bars(panel: U8, views: tuple[ViewErrors, ...], largest: float) -> None:
    """Root mean square error of each view, left and right side by side."""
    left_edge, pitch = 60, (panel.shape[1] - 60) / len(views)
    bar = max(1, min(18, int(0.4 * pitch)))
    for tick in round_ticks(0, largest, 4):
        y = _BARS - round(tick / largest * (_BARS - 10))
        cv2.line(panel, (left_edge - 4, y), (panel.shape[1], y), _PANEL, 1)
        draw_text(panel, f"{tick:g} px", (left_edge - 8, y + 5), 0.4, FAINT, right=True)
    step = int(np.ceil(90 / pitch))
    for number, view in enumerate(views):
        x = left_edge + round((number + 0.5) * pitch)
        for rms, color, begin in ((view.rms_left, _LEFT, x - bar), (view.rms_right, _RIGHT, x)):
            y = _BARS - round(rms / largest * (_BARS - 10))
            cv2.rectangle(panel, (begin, y), (begin + bar - 1, _BARS), color, -1)
        if number % step == 0:
            draw_text(panel, view.name[-14:], (x - bar, _BARS + 18), 0.36, TEXT)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots the calibration of a light plane: the stripes on the boards, and their distances from the plane."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.active.light_stripe.plane_calibration import PlaneCalibration
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.plots.drawing import FAINT, Color, canvas, draw_text, round_ticks, turbo

__all__ = ["light_plane_plot"]

_WIDTH, _MARGIN, _TITLE, _CAPTION = 560, 16, 36, 34
_PANEL: Color = (48, 42, 38)
_LARGEST = 4.0  # residuals shown, in units of their rms


def light_plane_plot(calibration: PlaneCalibration, camera: CameraModel) -> U8:
    """The stripes in the image, and their residuals over the depth, uint8 (H', W', 3) BGR.

    Points have the color of their residual: turbo from the largest negative to the largest positive one.
    """
    height = round(_WIDTH * camera.height / camera.width)
    image = canvas(2 * _WIDTH + 3 * _MARGIN, _TITLE + height + _CAPTION)
    largest = max(_LARGEST * calibration.rms_m, 1e-6)
    panels = [image[_TITLE : _TITLE + height, x : x + _WIDTH] for x in (_MARGIN, 2 * _MARGIN + _WIDTH)]
    for panel in panels:
        panel[:] = _PANEL
    depths = np.concatenate([stripe.points_m[:, 2] for stripe in calibration.stripes])
    low, high = float(depths.min()), float(depths.max())
    _draw_levels(panels[1], largest)
    for stripe, residuals in zip(calibration.stripes, calibration.residuals_m, strict=True):
        colors = turbo(np.clip(0.5 + 0.5 * residuals / largest, 0, 1).astype(np.float32)[None])[0]
        _draw_points(panels[0], stripe.points_px * _WIDTH / camera.width, colors)
        along = 20 + (stripe.points_m[:, 2] - low) / max(high - low, 1e-9) * (_WIDTH - 40)
        _draw_points(panels[1], np.column_stack((along, height * (0.5 - 0.5 * residuals / largest))), colors)
    caption = f"{len(calibration.stripes)} stripes, color as at the right"
    draw_text(image, caption, (_MARGIN, _TITLE + height + 22), color=FAINT)
    caption = f"distance from the plane, mm, over the depth, {low:.2f} to {high:.2f} m"
    draw_text(image, caption, (2 * _MARGIN + _WIDTH, _TITLE + height + 22), color=FAINT)
    A, B, C = calibration.plane.normal
    title = (
        f"{A:.4f} X {B:+.4f} Y {C:+.4f} Z {calibration.plane.d_m:+.4f} m = 0, distance of the points: median "
        f"{1e3 * calibration.median_m:.3f} mm, rms {1e3 * calibration.rms_m:.3f} mm"
    )
    draw_text(image, title, (_MARGIN, 25), 0.55)
    return image


def _draw_points(panel: U8, points: F64, colors: U8) -> None:
    for (x, y), color in zip(np.round(points * 16).astype(int), colors, strict=True):
        cv2.circle(panel, (int(x), int(y)), 24, tuple(int(value) for value in color), -1, cv2.LINE_AA, shift=4)


def _draw_levels(panel: U8, largest_m: float) -> None:
    height = len(panel)
    for tick in round_ticks(-1e3 * largest_m, 1e3 * largest_m, 8):
        y = round(height * (0.5 - 0.5 * tick / (1e3 * largest_m)))
        cv2.line(panel, (0, y), (panel.shape[1], y), FAINT if tick == 0 else (72, 66, 62), 1)
        draw_text(panel, f"{tick:g}", (4, y - 3), 0.38, FAINT)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots a light stripe scan: an image with its stripe, and the merged points from three sides."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.active.light_stripe.scanner import ScannedProfile
from stereo_depth_ros.core.types import F32, F64, U8, Frame
from stereo_depth_ros.plots.drawing import FAINT, canvas, draw_text, turbo

__all__ = ["stripe_scan_plot"]

_PANEL, _MARGIN, _TITLE, _CAPTION = 480, 16, 36, 30
_VIEWS = (("from the camera", 0, 1, 2), ("from the right", 2, 1, 0), ("from above", 0, 2, 1))  # right, down, depth
_OUTSIDE = 0.5  # % of the points on each side that the frame may cut off


def stripe_scan_plot(frame: Frame, profile: ScannedProfile, points_m: F64, level: F32, title: str) -> U8:
    """Four panels, uint8 (H', W', 3) BGR: the image with its points in magenta, and the cloud along each axis.

    Points have the color of their depth in the panel, turbo from far to near, shaded by their gray level.

    Args:
        frame: an image of the scan, raw.
        profile: its profile.
        points_m: float64 (N, 3), the merged points, meters; at least one.
        level: float32 (N,), their gray levels.
        title: one line above.
    """
    image = canvas(2 * _PANEL + 3 * _MARGIN, _TITLE + 2 * (_PANEL + _CAPTION))
    low, high = np.percentile(points_m, [_OUTSIDE, 100 - _OUTSIDE], axis=0)
    size_m = max(float((high - low).max()), 1e-6)
    places = [(_MARGIN + x * (_PANEL + _MARGIN), _TITLE + y * (_PANEL + _CAPTION)) for y in (0, 1) for x in (0, 1)]
    _draw_image(image, places[0], frame, profile)
    for (caption, right, down, depth), (x, y) in zip(_VIEWS, places[1:], strict=True):
        panel = image[y : y + _PANEL, x : x + _PANEL]
        _draw_points(panel, points_m[:, [right, down, depth]], level, (low + high)[[right, down, depth]] / 2, size_m)
        draw_text(image, f"{caption}, {1e3 * size_m:.0f} mm wide", (x, y + _PANEL + 18), color=FAINT)
    draw_text(image, title, (_MARGIN, 25), 0.55)
    return image


def _draw_image(image: U8, place: tuple[int, int], frame: Frame, profile: ScannedProfile) -> None:
    pixels = frame.pixels
    if pixels.ndim == 2:
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR), np.uint8)
    elif frame.encoding == "rgb8":
        pixels = np.ascontiguousarray(pixels[..., ::-1])
    height, width = pixels.shape[:2]
    scale = _PANEL / max(height, width)
    shown = np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    for x, y in np.round(((profile.found.profile.points_px() + 0.5) * scale - 0.5) * 16).astype(int):
        cv2.circle(shown, (int(x), int(y)), 16, (255, 0, 255), -1, cv2.LINE_AA, shift=4)
    x, y = place
    image[y : y + len(shown), x : x + shown.shape[1]] = shown
    draw_text(image, f"{len(profile.found.lines)} points of one image", (x, y + _PANEL + 18), color=FAINT)


def _draw_points(panel: U8, points: F64, level: F32, center: F64, size_m: float) -> None:
    """Orthographic view along the third coordinate, the nearest points in front."""
    order = np.argsort(-points[:, 2])
    x, y, depth = ((points[order] - center) / (1.04 * size_m)).T
    columns, rows = (np.rint((values + 0.5) * (_PANEL - 1)).astype(int) for values in (x, y))
    inside = (columns >= 0) & (columns < _PANEL) & (rows >= 0) & (rows < _PANEL)
    colors = turbo(np.clip(0.5 - depth[inside], 0, 1).astype(np.float32)[None])[0]
    shade = 0.45 + 0.55 * np.clip(level[order][inside] / max(float(np.percentile(level, 95)), 1.0), 0, 1)
    panel[rows[inside], columns[inside]] = (colors * shade[:, None]).astype(np.uint8)

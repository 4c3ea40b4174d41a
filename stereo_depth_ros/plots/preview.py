# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A preview image: the left image beside its color-mapped depth, with a legend in meters."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.plots.drawing import save_png

__all__ = ["color_depth", "legend_ticks", "preview", "save_preview"]

_BACKGROUND = (24, 20, 18)
_TEXT = (235, 232, 228)
_FAINT = (160, 154, 148)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_PANEL_WIDTH = 640  # smaller images are enlarged to about this width, so that text and image are in proportion
_MARGIN, _TITLE, _CAPTION, _LEGEND = 16, 44, 30, 92
_BAR_WIDTH, _TICK_GAP = 18, 26
_FINE, _FEWEST_TICKS = tuple(k / 100 for k in range(101, 1000)), 4


def preview(left: U8, depth_m: F32, title: str = "") -> U8:
    """The image as a uint8 (H', W', 3) BGR image.

    Colors are linear in disparity, that is in 1 / Z: turbo from far (blue) to near (red), over the 1st to the 99th
    percentile; invalid pixels are black.

    Args:
        left: uint8 (H, W) or (H, W, 3) BGR, the rectified left image.
        depth_m: float32 (H, W), meters, NaN where invalid.
        title: one line over both.

    Raises:
        ImageError: the two have different sizes.
    """
    if left.shape[:2] != depth_m.shape:
        raise ImageError(f"left image {left.shape[:2]} and depth {depth_m.shape} differ in size: take one pair")
    near_m, far_m = _depth_range(depth_m)
    scale = max(1, round(_PANEL_WIDTH / left.shape[1]))
    panels = (
        _enlarge(left if left.ndim == 3 else cv2.cvtColor(left, cv2.COLOR_GRAY2BGR), scale),
        _enlarge(color_depth(depth_m, near_m, far_m), scale),
    )
    valid = np.count_nonzero(np.isfinite(depth_m)) / depth_m.size
    captions = ("left image, rectified", f"depth, {100 * valid:.1f} % of pixels valid")
    return _compose(panels, captions, title, near_m, far_m)


def save_preview(path: Path, left: U8, depth_m: F32, title: str = "", *, overwrite: bool = False) -> None:
    """Write :func:`preview` as a PNG.

    Raises:
        ImageError: the sizes differ.
        OutputError: the file is there and ``overwrite`` is false, or it cannot be written.
    """
    save_png(path, preview(left, depth_m, title), overwrite=overwrite)


def color_depth(depth_m: F32, near_m: float, far_m: float) -> U8:
    """Depth as colors, uint8 (H, W, 3) BGR: turbo (Mikhailov 2019), linear in 1 / Z, black where invalid."""
    valid = np.isfinite(depth_m) & (depth_m > 0)
    nearness = _nearness(np.where(valid, depth_m, far_m), near_m, far_m)
    colors: U8 = np.asarray(cv2.applyColorMap((255 * nearness + 0.5).astype(np.uint8), cv2.COLORMAP_TURBO))
    colors[~valid] = 0
    return colors


def legend_ticks(near_m: float, far_m: float, bar_px: int) -> list[float]:
    """Round depths in meters between the ends of the legend, at least a line of text apart on its bar."""
    ticks: list[float] = []
    places: list[float] = []
    for tick in _round_values(near_m, far_m):
        place = float(_nearness(tick, near_m, far_m)) * bar_px
        if all(abs(place - other) >= _TICK_GAP for other in places):
            ticks.append(tick)
            places.append(place)
    return sorted(ticks)


def _round_values(near_m: float, far_m: float) -> list[float]:
    """Values between the ends, the roundest first: 1, 10, then 2, 5, 20, then 1.5, 3, 4, ...; finer ones if need be."""
    found: dict[float, None] = {}
    decades = range(math.floor(math.log10(near_m)), math.ceil(math.log10(far_m)) + 1)
    for steps in ((1.0,), (2.0, 5.0), (1.5, 3.0, 4.0, 7.0), (1.2, 1.8, 2.5, 6.0, 8.0), _FINE):
        if steps is _FINE and len(found) >= _FEWEST_TICKS:
            break
        for decade in decades:
            for step in steps:
                value = round(step * 10.0**decade, 6)
                if near_m <= value <= far_m:
                    found[value] = None
    return list(found)


def _depth_range(depth_m: F32) -> tuple[float, float]:
    valid = depth_m[np.isfinite(depth_m) & (depth_m > 0)]
    if not valid.size:
        return 1.0, 10.0
    near_m, far_m = (float(value) for value in np.percentile(valid, (1, 99)))
    return (near_m, far_m) if far_m > 1.02 * near_m else (0.9 * near_m, 1.1 * far_m)


def _nearness(depth_m: F32 | float, near_m: float, far_m: float) -> F32:
    """0 at the far end of the scale, 1 at the near end, linear in 1 / Z."""
    scaled = (1 / depth_m - 1 / far_m) / (1 / near_m - 1 / far_m)
    return np.clip(scaled, 0.0, 1.0).astype(np.float32)


def _enlarge(image: U8, scale: int) -> U8:
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST))


def _compose(panels: tuple[U8, U8], captions: tuple[str, str], title: str, near_m: float, far_m: float) -> U8:
    height, width = panels[0].shape[:2]
    top = _MARGIN + (_TITLE if title else 0)
    canvas = np.empty((top + height + _CAPTION + _MARGIN // 2, 2 * width + 3 * _MARGIN + _LEGEND, 3), np.uint8)
    canvas[:] = _BACKGROUND
    for index, (panel, caption) in enumerate(zip(panels, captions, strict=True)):
        x = _MARGIN + index * (width + _MARGIN)
        canvas[top : top + height, x : x + width] = panel
        _text(canvas, caption, (x, top + height + 22), 0.5, _FAINT)
    if title:
        _text(canvas, title, (_MARGIN, _MARGIN + 24), 0.7, _TEXT)
    _draw_legend(canvas, 3 * _MARGIN + 2 * width - 2, top, height, near_m, far_m)
    return canvas


def _draw_legend(canvas: U8, x: int, top: int, height: int, near_m: float, far_m: float) -> None:
    """A bar, near at the top, linear in 1 / Z as the colors are."""
    nearness = np.linspace(255, 0, height).astype(np.uint8)[:, None]
    canvas[top : top + height, x : x + _BAR_WIDTH] = cv2.applyColorMap(nearness, cv2.COLORMAP_TURBO)
    for tick in legend_ticks(near_m, far_m, height):
        y = top + round((1 - float(_nearness(tick, near_m, far_m))) * (height - 1))
        cv2.line(canvas, (x + _BAR_WIDTH, y), (x + _BAR_WIDTH + 4, y), _FAINT, 1)
        baseline = min(max(y + 5, top + 10), top + height)
        _text(canvas, f"{tick:g} m", (x + _BAR_WIDTH + 9, baseline), 0.45, _TEXT)


def _text(canvas: U8, text: str, place: tuple[int, int], size: float, color: tuple[int, int, int]) -> None:
    cv2.putText(canvas, text, place, _FONT, size, color, 1, cv2.LINE_AA)

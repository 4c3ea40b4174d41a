# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A preview image: the left image beside its color-mapped depth, with a legend in meters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.plots.drawing import FAINT, canvas, draw_color_bar, draw_text, enlarged, save_png, turbo

__all__ = ["color_depth", "legend_ticks", "preview", "save_preview"]

_PANEL_WIDTH = 640  # smaller images are enlarged to about this width, so that text and image are in proportion
_MARGIN, _TITLE, _CAPTION, _LEGEND = 16, 44, 30, 92
_TICK_GAP = 26
_FINE, _FEWEST_TICKS = tuple(k / 100 for k in range(101, 1000)), 4


def preview(left: U8, depth_m: F32, title: str = "", caption: str = "left image, rectified") -> U8:
    """Left image and color-mapped depth side by side, uint8 (H', W', 3) BGR.

    Colors are linear in disparity, that is in 1 / Z: turbo from far (blue) to near (red), over the 1st to the 99th
    percentile; invalid pixels are black.

    Args:
        left: uint8 (H, W) or (H, W, 3) BGR, the rectified left image.
        depth_m: float32 (H, W), meters, NaN where invalid.
        title: one line above both.
        caption: one line below the image.

    Raises:
        ImageError: the two have different sizes.
    """
    if left.shape[:2] != depth_m.shape:
        raise ImageError(
            f"left image {left.shape[:2]} and depth {depth_m.shape} differ in size",
            value=depth_m.shape,
            limit=left.shape[:2],
            remedy="use images of one pair",
        )
    near_m, far_m = _depth_range(depth_m)
    panels = (enlarged(left, _PANEL_WIDTH), enlarged(color_depth(depth_m, near_m, far_m), _PANEL_WIDTH))
    valid = np.count_nonzero(np.isfinite(depth_m)) / depth_m.size
    captions = (caption, f"depth, {100 * valid:.1f} % of pixels valid")
    return _compose(panels, captions, title, near_m, far_m)


def save_preview(path: Path, left: U8, depth_m: F32, title: str = "", *, overwrite: bool = False) -> None:
    """Write :func:`preview` as a PNG.

    Raises:
        ImageError: the sizes differ.
        OutputError: the file is there and ``overwrite`` is false, or it cannot be written.
    """
    save_png(path, preview(left, depth_m, title), overwrite=overwrite)


def color_depth(depth_m: F32, near_m: float, far_m: float) -> U8:
    """Depth as colors, uint8 (H, W, 3) BGR: turbo, linear in 1 / Z, black where invalid."""
    valid = np.isfinite(depth_m) & (depth_m > 0)
    return turbo(_nearness(np.where(valid, depth_m, np.nan), near_m, far_m))


def legend_ticks(near_m: float, far_m: float, bar_px: int) -> list[float]:
    """Round depths in meters between the ends of the legend, at least a line of text apart."""
    ticks: list[float] = []
    places: list[float] = []
    for tick in _round_values(near_m, far_m):
        place = float(_nearness(tick, near_m, far_m)) * bar_px
        if all(abs(place - other) >= _TICK_GAP for other in places):
            ticks.append(tick)
            places.append(place)
    return sorted(ticks)


def _round_values(near_m: float, far_m: float) -> list[float]:
    """Values between the ends, the roundest first: 1, 10, then 2, 5, 20, then 1.5, 3, 4, ...; finer ones if too few."""
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


def _compose(panels: tuple[U8, U8], captions: tuple[str, str], title: str, near_m: float, far_m: float) -> U8:
    height, width = panels[0].shape[:2]
    top = _MARGIN + (_TITLE if title else 0)
    image = canvas(2 * width + 3 * _MARGIN + _LEGEND, top + height + _CAPTION + _MARGIN // 2)
    for index, (panel, caption) in enumerate(zip(panels, captions, strict=True)):
        x = _MARGIN + index * (width + _MARGIN)
        image[top : top + height, x : x + width] = panel
        draw_text(image, caption, (x, top + height + 22), 0.5, FAINT)
    if title:
        draw_text(image, title, (_MARGIN, _MARGIN + 24), 0.7)
    ticks = [(float(_nearness(tick, near_m, far_m)), f"{tick:g} m") for tick in legend_ticks(near_m, far_m, height)]
    draw_color_bar(image, 3 * _MARGIN + 2 * width - 2, top, height, ticks)
    return image

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Preview of depth from focus without focus distances: the all-in-focus image beside the sharpest image by colors."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.plots.drawing import FAINT, canvas, draw_color_bar, draw_text, enlarged, round_ticks, turbo

__all__ = ["focus_plot"]

_PANEL_WIDTH, _MARGIN, _TITLE, _CAPTION, _LEGEND = 640, 16, 44, 30, 92
_TICKS = 8


def focus_plot(all_in_focus: U8, index: F32, count: int, title: str) -> U8:
    """Both side by side, uint8 (H', W', 3) BGR: turbo from the first (blue) to the last image, invalid is black.

    Args:
        all_in_focus: uint8 (H, W) or (H, W, 3) BGR.
        index: float32 (H, W), number of the sharpest image from 0, NaN where invalid.
        count: number of images.
        title: one line above.
    """
    colors = turbo((index / np.float32(count - 1)).astype(np.float32))
    panels = [enlarged(image, _PANEL_WIDTH) for image in (all_in_focus, colors)]
    height, width = panels[0].shape[:2]
    image = canvas(2 * width + 3 * _MARGIN + _LEGEND, _MARGIN + _TITLE + height + _CAPTION)
    valid = 100 * float(np.isfinite(index).mean())
    for number, (panel, caption) in enumerate(
        zip(panels, ("all in focus", f"sharpest image, {valid:.1f} % of pixels valid"), strict=True)
    ):
        x = _MARGIN + number * (width + _MARGIN)
        image[_TITLE : _TITLE + height, x : x + width] = panel
        draw_text(image, caption, (x, _TITLE + height + 22), 0.5, FAINT)
    draw_text(image, title, (_MARGIN, 30), 0.7)
    ticks = [((tick - 1) / (count - 1), f"{tick:g}") for tick in round_ticks(1, count, _TICKS)]
    draw_color_bar(image, 2 * width + 3 * _MARGIN - 2, _TITLE, height, ticks)
    return image

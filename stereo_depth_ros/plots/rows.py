# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots both rectified images side by side with horizontal lines across both, to compare their rows."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.plots.drawing import Color, canvas, draw_text

__all__ = ["rows_plot"]

_WIDTH = 640  # of each image, at least
_LINES = 14
_MARGIN, _TITLE = 12, 40
_COLORS: tuple[Color, ...] = ((90, 200, 250), (230, 190, 90), (130, 220, 130))


def rows_plot(left: U8, right: U8, title: str) -> U8:
    """Equidistant horizontal lines across both images: corresponding points lie on the same line.

    Args:
        left, right: uint8 (H, W) or (H, W, 3) BGR, rectified.
        title: one line above.

    Returns:
        uint8 (H', W', 3), BGR.
    """
    scale = max(1.0, _WIDTH / left.shape[1])
    images = [cv2.resize(each, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for each in (left, right)]
    height, width = images[0].shape[:2]
    whole = canvas(2 * width + 3 * _MARGIN, height + _TITLE + _MARGIN)
    for number, image in enumerate(images):
        x = _MARGIN + number * (width + _MARGIN)
        colored = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        whole[_TITLE : _TITLE + height, x : x + width] = colored
    for number, y in enumerate(np.linspace(0, height, _LINES + 2)[1:-1].round().astype(int)):
        color = _COLORS[number % len(_COLORS)]
        cv2.line(whole, (0, _TITLE + int(y)), (whole.shape[1], _TITLE + int(y)), color, 1)
    draw_text(whole, title, (_MARGIN, 26), 0.6)
    return whole

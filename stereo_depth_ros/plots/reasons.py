# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots why pixels have no disparity beside the confidence of those that have one, with legends."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.types import F32, U8, Reason
from stereo_depth_ros.plots.drawing import FAINT, canvas, draw_bar, draw_color_bar, draw_text, enlarged, turbo
from stereo_depth_ros.stages.reason_colors import REASON_COLORS, reason_colors

__all__ = ["reason_plot"]

_PANEL_WIDTH = 560
_MARGIN, _TITLE, _CAPTION, _LEGEND = 16, 36, 30, 190
_LABEL_X, _ROW = 27, 24
_NAMES = {
    Reason.BORDER: "border",
    Reason.RANGE: "range, error",
    Reason.SHADOW: "shadow",
    Reason.TEXTURE: "texture",
    Reason.UNIQUENESS: "uniqueness",
    Reason.LEFT_RIGHT: "left-right",
    Reason.SPECKLE: "speckle",
    Reason.NO_MATCH: "other",
}


def reason_plot(left: U8, reasons: U8, confidence: F32 | None, title: str) -> U8:
    """Two panels beside each other as a uint8 (H', W', 3) BGR image; the second one is empty without a confidence.

    Args:
        left: uint8 (H, W), the rectified left image.
        reasons: uint8 (H, W), bits of :class:`Reason`.
        confidence: float32 (H, W), 0..1, 0 where invalid.
        title: one line above.
    """
    height, width = enlarged(left, _PANEL_WIDTH).shape[:2]
    image = canvas(2 * width + 3 * _MARGIN + _LEGEND, _TITLE + max(height + _CAPTION, _ROW * len(_NAMES)) + _MARGIN)
    draw_text(image, title, (_MARGIN, 28), 0.65)
    shares = {reason: float(np.mean((reasons & reason.value) != 0)) for reason in REASON_COLORS}
    valid = 100 * float(np.mean(reasons == 0))
    panels = [(reason_colors(reasons, left), f"{valid:.1f} % of the pixels have a disparity")]
    if confidence is not None:
        colors = turbo(np.where(reasons == 0, confidence, np.float32(np.nan)))
        panels.append((colors, f"confidence, median {_median(confidence, reasons):.2f}"))
    top = _TITLE + _MARGIN // 2
    for index, (panel, text) in enumerate(panels):
        x = _MARGIN + index * (width + _MARGIN)
        image[top : top + height, x : x + width] = enlarged(panel, _PANEL_WIDTH)
        draw_text(image, text, (x, top + height + 20), color=FAINT)
    x = 2 * width + 3 * _MARGIN
    present = [reason for reason, share in shares.items() if share > 0]
    for row, reason in enumerate(present):
        draw_bar(image, (x, top + _ROW * row), REASON_COLORS[reason])
        draw_text(image, f"{_NAMES[reason]} {100 * shares[reason]:.1f} %", (x + _LABEL_X, top + _ROW * row + 13))
    if confidence is not None:
        begin = _ROW * (len(present) + 1)
        if height - begin > 2 * _ROW:
            draw_color_bar(image, x, top + begin, height - begin, [(0.0, "0"), (0.5, "0.5"), (1.0, "1")])
    return image


def _median(confidence: F32, reasons: U8) -> float:
    found = confidence[reasons == 0]
    return float(np.median(found)) if found.size else 0.0

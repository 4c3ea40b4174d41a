# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The overlay for the operator who holds a calibration board: image, views taken so far, what to do next."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from stereo_depth_ros.calibration.board_views import Coverage
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.plots.drawing import FAINT, TEXT, Color, canvas, draw_bar, draw_text

__all__ = ["operator_overlay"]

_LINE, _MARGIN, _BAR = 22, 12, 120
_TAKEN: Color = (150, 190, 90)
_NOW: Color = (60, 200, 250)


def operator_overlay(
    left: U8, taken: Sequence[F64], seen: F64 | None, coverage: Coverage, outcome: str, advice: Sequence[str]
) -> U8:
    """The left image with the outlines of the views taken and the corners detected now, above bars and advice.

    Args:
        left: uint8 (H, W), gray.
        taken: corners of each view, float64 (N, 2), px.
        seen: corners detected in this image, float64 (N, 2), px; None where no board was found.
        coverage: of the views taken.
        outcome: of this image, for example why it gave no view.
        advice: what to do next.

    Returns:
        uint8 (H', W, 3), BGR.
    """
    height, width = left.shape
    below = _MARGIN + _LINE * (2 + max(1, len(advice)))
    image = canvas(width, height + below)
    image[:height] = cv2.cvtColor(left, cv2.COLOR_GRAY2BGR)
    for corners in taken:
        cv2.polylines(image[:height], [cv2.convexHull(_whole_px(corners))], True, _TAKEN, 1, cv2.LINE_AA)
    if seen is not None:
        for x, y in _whole_px(seen):
            cv2.circle(image[:height], (int(x), int(y)), 3, _NOW, 1, cv2.LINE_AA)
    draw_text(image, f"{len(taken)} views; {outcome}", (_MARGIN, height + _LINE))
    _draw_bars(image[height + _LINE :], coverage)
    for number, text in enumerate(advice or ("enough: calibrate",)):
        draw_text(image, text, (_MARGIN, height + _LINE * (3 + number)), color=FAINT if advice else TEXT)
    return image


def _whole_px(points: F64) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    return np.round(points).astype(np.int32)


def _draw_bars(panel: U8, coverage: Coverage) -> None:
    """One bar for each part of the coverage, side by side."""
    step = panel.shape[1] // 4
    for number, name in enumerate(("x", "y", "size", "skew")):
        x = _MARGIN + number * step
        length = min(_BAR, step - 60)
        draw_text(panel, name, (x, 16), color=FAINT)
        draw_bar(panel, (x + 40, 6), _TAKEN, getattr(coverage, name), (length, 10))

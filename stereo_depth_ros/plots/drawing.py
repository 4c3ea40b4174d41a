# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drawing primitives that the plots share: text, axes, color maps, bars, enlarged images, PNG files."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.files.output import write_file

__all__ = [
    "FAINT",
    "TEXT",
    "Axes",
    "Color",
    "canvas",
    "draw_bar",
    "draw_color_bar",
    "draw_text",
    "enlarged",
    "round_ticks",
    "save_png",
    "turbo",
]

Color: TypeAlias = tuple[int, int, int]  # BGR
TEXT: Color = (235, 232, 228)
FAINT: Color = (160, 154, 148)
_BACKGROUND: Color = (24, 20, 18)
_GRID: Color = (52, 46, 42)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_BAR_WIDTH = 18
_SHIFT = 4  # fractional bits of the coordinates of lines


def canvas(width: int, height: int) -> U8:
    """An empty image, uint8 (height, width, 3) BGR."""
    return np.full((height, width, 3), _BACKGROUND, np.uint8)


def draw_text(
    image: U8, text: str, place: tuple[int, int], size: float = 0.45, color: Color = TEXT, right: bool = False
) -> None:
    """One line of text; the left end, or right end, of its baseline is at ``place`` (x, y), px."""
    width = cv2.getTextSize(text, _FONT, size, 1)[0][0] if right else 0
    cv2.putText(image, text, (place[0] - width, place[1]), _FONT, size, color, 1, cv2.LINE_AA)


@dataclass(frozen=True)
class Axes:
    """Two axes that start at 0, in a part of an image.

    Attributes:
        image: uint8 (H, W, 3) BGR, drawn on.
        left, top, right, bottom: edges of the plot area, px.
        x_max, y_max: values at the right and the top edge.
    """

    image: U8
    left: int
    top: int
    right: int
    bottom: int
    x_max: float
    y_max: float

    def draw_grid(self, caption: str) -> None:
        """Grid lines at round values, their values, and a caption below."""
        for tick in round_ticks(0, self.y_max, 6):
            y = round(float(self._rows(np.float64(tick))))
            cv2.line(self.image, (self.left, y), (self.right, y), _GRID, 1)
            draw_text(self.image, f"{tick:g}", (self.left - 8, y + 5), color=FAINT, right=True)
        for tick in round_ticks(0, self.x_max, 10):
            x, text = round(float(self._columns(np.float64(tick)))), f"{tick:g}"
            cv2.line(self.image, (x, self.top), (x, self.bottom), _GRID, 1)
            draw_text(self.image, text, (x + 4 * len(text), self.bottom + 18), color=FAINT, right=True)
        draw_text(self.image, caption, (self.left, self.bottom + 40), color=FAINT)

    def draw_line(self, x: F64, y: F64, color: Color) -> None:
        """A line through points, float64 (N,), in the values of the axes."""
        points = np.stack((self._columns(x), self._rows(y)), axis=-1) * (1 << _SHIFT)
        cv2.polylines(self.image, [points.round().astype(np.int32)], False, color, 2, cv2.LINE_AA, _SHIFT)

    def _columns(self, x: F64 | np.float64) -> F64:
        return np.asarray(self.left + x / self.x_max * (self.right - self.left), np.float64)

    def _rows(self, y: F64 | np.float64) -> F64:
        return np.asarray(self.bottom - y / self.y_max * (self.bottom - self.top), np.float64)


def turbo(share: F32) -> U8:
    """Colors of values 0..1, float32 (H, W), as uint8 (H, W, 3) BGR (turbo, Mikhailov 2019); black where NaN."""
    invalid = np.isnan(share)
    levels = (255 * np.where(invalid, 0, share) + 0.5).astype(np.uint8)
    colors: U8 = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), np.uint8)
    colors[invalid] = 0
    return colors


def draw_color_bar(
    image: U8,
    x: int,
    top: int,
    height: int,
    ticks: Iterable[tuple[float, str]],
    colormap: int = cv2.COLORMAP_TURBO,
) -> None:
    """A vertical color scale, 1 at the top, with its labels.

    Args:
        ticks: place on the scale, 0..1, and label.
        colormap: number of the color map in OpenCV.
    """
    levels = np.linspace(255, 0, height).astype(np.uint8)[:, None]
    image[top : top + height, x : x + _BAR_WIDTH] = cv2.applyColorMap(levels, colormap)
    for share, label in ticks:
        y = top + round((1 - share) * (height - 1))
        cv2.line(image, (x + _BAR_WIDTH, y), (x + _BAR_WIDTH + 4, y), FAINT, 1)
        draw_text(image, label, (x + _BAR_WIDTH + 9, min(max(y + 5, top + 10), top + height)))


def draw_bar(
    image: U8, place: tuple[int, int], color: Color, share: float = 1.0, size: tuple[int, int] = (_BAR_WIDTH, 16)
) -> None:
    """A framed horizontal bar, filled from the left to ``share``; ``place`` is its upper left corner (x, y), px."""
    (x, y), (width, height) = place, size
    cv2.rectangle(image, (x, y), (x + round(share * width), y + height), color, -1)
    cv2.rectangle(image, (x, y), (x + width, y + height), FAINT, 1)


def enlarged(image: U8, width: int) -> U8:
    """The image in BGR, enlarged by a whole factor to about ``width`` columns; larger images keep their size."""
    scale = max(1, round(width / image.shape[1]))
    colored = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return np.asarray(cv2.resize(colored, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST), np.uint8)


def round_ticks(low: float, high: float, most: int) -> list[float]:
    """At most ``most`` + 1 multiples of 1, 2 or 5 times a power of ten within low..high."""
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    step *= next(factor for factor in (1, 2, 5, 10) if (high - low) / (factor * step) <= most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(step * k, 10) for k in range(first, last + 1)]


def save_png(path: Path, image: U8, *, overwrite: bool = False) -> None:
    """Write a PNG and make the folders it lies in.

    Args:
        path: the file.
        image: uint8 (H, W) gray or (H, W, 3) BGR.
        overwrite: replace a file that is there.

    Raises:
        ImageError: an image that PNG cannot hold.
        OutputError: the file is there and ``overwrite`` is false, or it cannot be written.
    """
    done, encoded = cv2.imencode(".png", image)
    if not done:
        raise ImageError("cannot be encoded as PNG", subject=str(path), remedy="check the size of the images")
    write_file(path, encoded.tobytes(), overwrite=overwrite, make_folders=True)

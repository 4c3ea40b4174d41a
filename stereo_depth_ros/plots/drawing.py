# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What drawn images have in common: colors, text, panels of images, round ticks, files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.files.output import write_file

__all__ = ["BACKGROUND", "FAINT", "TEXT", "Color", "canvas", "draw_text", "enlarged", "round_ticks", "save_png"]

Color: TypeAlias = tuple[int, int, int]
BACKGROUND: Color = (24, 20, 18)
TEXT: Color = (235, 232, 228)
FAINT: Color = (160, 154, 148)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def canvas(width: int, height: int) -> U8:
    """An empty image, uint8 (height, width, 3) BGR."""
    return np.full((height, width, 3), BACKGROUND, np.uint8)


def draw_text(
    image: U8, text: str, place: tuple[int, int], size: float = 0.45, color: Color = TEXT, right: bool = False
) -> None:
    """One line whose left end, or right end, of its base line is at ``place`` (x, y), px."""
    width = cv2.getTextSize(text, _FONT, size, 1)[0][0] if right else 0
    cv2.putText(image, text, (place[0] - width, place[1]), _FONT, size, color, 1, cv2.LINE_AA)


def enlarged(image: U8, width: int) -> U8:
    """The image in BGR, each pixel repeated so often that it has about ``width`` columns; large images stay."""
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
        raise ImageError(f"cannot encode {path} as PNG: check the size of the images")
    write_file(path, encoded.tobytes(), overwrite=overwrite, make_folders=True)

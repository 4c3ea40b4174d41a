# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The image circle of a lens that does not light the corners of the image, found from the images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stereo_depth_ros.core.types import F64, U8

__all__ = ["LensCircle", "LitPixels"]

_DARK = 0.12  # of the bright pixels, below which a pixel is not lit
_LEAST_GRAY = 14  # noise and stray light are darker
_CORNER = 0.03  # of the shorter side of the image: these squares in its corners are dark
_OFF = 0.02  # of the radius, by which the edge of what is lit may differ from the circle
_MOST_OUTSIDE, _LEAST_INSIDE, _LEAST_ON_EDGE = 0.01, 0.9, 0.6  # shares of pixels lit, and of points of the edge


@dataclass(frozen=True)
class LensCircle:
    """Center and radius, px."""

    x: float
    y: float
    radius: float

    def reach_px(self, cx: float, cy: float) -> float:
        """The largest distance of a point in the circle from a principal point."""
        return float(np.hypot(self.x - cx, self.y - cy)) + self.radius

    def box(self, size: tuple[int, int]) -> tuple[float, float, float, float]:
        """Left and upper edge, width and height of what is lit in an image of ``size``, px."""
        x0, y0 = max(0.0, self.x - self.radius), max(0.0, self.y - self.radius)
        x1, y1 = min(size[0] - 1.0, self.x + self.radius), min(size[1] - 1.0, self.y + self.radius)
        return x0, y0, x1 - x0 + 1, y1 - y0 + 1

    def __str__(self) -> str:
        return f"center ({self.x:.0f}, {self.y:.0f}), radius {self.radius:.0f} px"


class LitPixels:
    """The pixels of a camera that some image has lit."""

    def __init__(self) -> None:
        self._brightest: U8 | None = None

    def add(self, gray: U8) -> None:
        """Add an image, uint8 (H, W); those of another size than the first one are ignored."""
        if self._brightest is None:
            self._brightest = gray.copy()
        elif self._brightest.shape == gray.shape:
            np.maximum(self._brightest, gray, out=self._brightest)

    def circle(self) -> LensCircle | None:
        """The image circle; None where a corner is lit, and where the edge of what is lit is not a circle."""
        if self._brightest is None:
            return None
        smooth = cv2.medianBlur(self._brightest, 3)
        lit = smooth > max(_LEAST_GRAY, _DARK * float(np.percentile(smooth, 95)))
        side = max(2, round(_CORNER * min(lit.shape)))
        if any(lit[rows, columns].any() for rows in _ends(side) for columns in _ends(side)):
            return None
        edge = _edge(lit)
        return _fitted(edge, lit) if len(edge) >= 8 else None


def _ends(side: int) -> tuple[slice, slice]:
    return slice(0, side), slice(-side, None)


def _edge(lit: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> F64:
    """The first and last lit pixel of each row and column, float64 (N, 2), without those at the edge of the image."""
    points = []
    for mask, flipped in ((lit, False), (lit.T, True)):
        lines = np.flatnonzero(mask.any(axis=1))
        first = mask[lines].argmax(axis=1)
        last = mask.shape[1] - 1 - mask[lines, ::-1].argmax(axis=1)
        for ends in (first, last):
            inside = (ends > 0) & (ends < mask.shape[1] - 1)
            pair = (ends[inside], lines[inside])
            points.append(np.column_stack(pair[::-1] if flipped else pair))
    return np.concatenate(points).astype(np.float64)


def _fitted(edge: F64, lit: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> LensCircle | None:
    """The circle of least squares through most of the points, where it is what separates lit from dark."""
    kept = edge
    for _ in range(6):
        if len(kept) < 8:
            return None
        A = np.column_stack([kept, np.ones(len(kept))])
        (a, b, c), *_ = np.linalg.lstsq(A, np.square(kept).sum(axis=1), rcond=None)
        x, y = a / 2, b / 2
        if not (radius_sq := c + x**2 + y**2) > 0:
            return None
        radius = float(np.sqrt(radius_sq))
        off = np.abs(np.hypot(edge[:, 0] - x, edge[:, 1] - y) - radius)
        kept = edge[off <= max(1.5, 2.5 * float(np.median(off)))]
    height, width = lit.shape
    near = off <= max(1.5, _OFF * radius)
    if near.mean() < _LEAST_ON_EDGE or not (0 < x < width and 0 < y < height and 2 * radius > min(lit.shape) / 2):
        return None
    rows, columns = np.indices(lit.shape, sparse=True)
    distance = np.hypot(columns - x, rows - y)
    outside, inside = lit[distance > (1 + _OFF) * radius + 1], lit[distance < (1 - _OFF) * radius]
    if not outside.size or outside.mean() > _MOST_OUTSIDE or inside.mean() < _LEAST_INSIDE:
        return None
    return LensCircle(float(x), float(y), radius)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Color edges along the rows of an image: where they are, and how red, green and blue change.

After Zhang, Curless and Seitz 2002, section 3.2: edges are local maxima of the squared gradient summed over the
channels. Before, each channel is divided by its own contrast around the pixel, so that neither the color of the surface
nor a weak channel of the projector decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = ["I32", "ColorEdges", "contrast_limit", "find_edges", "smooth_columns"]

I32 = npt.NDArray[np.int32]

_MIN_CONTRAST = 8.0  # of the strongest channel, gray levels
_MIN_CONTRAST_SIGMAS = 6.0
_WEAK_CHANNEL = 0.25  # of the contrast of the strongest one; weaker channels are not amplified more
_LEAST_STEP = 0.5  # of an edge, of the least contrast
_MIN_CHANGE = 0.12  # of the contrast
_WINDOW_SIGMAS = 20.0  # the contrast is that of as many pixels to either side: some four stripes
_BLOCK_SIGMAS = 2.0


@dataclass(frozen=True, eq=False)
class ColorEdges:
    """The edges of all rows; only the first ``counts[y]`` of row y are set.

    Attributes:
        x_px: float32 (H, K), increasing along a row, sub-pixel.
        changes: float32 (H, K, 3), of red, green and blue; the largest magnitude is 1.
        counts: int32 (H,).
    """

    x_px: F32
    changes: F32
    counts: I32

    def some_rows(self, step: int) -> ColorEdges:
        """Every ``step``-th row."""
        return ColorEdges(self.x_px[::step].copy(), self.changes[::step].copy(), self.counts[::step].copy())


def contrast_limit(image: U8) -> float:
    """The least contrast of stripes, gray levels: six standard deviations of the noise, at least 8.

    The noise is that of second differences along the columns, across which vertical stripes do not change.
    """
    rows = np.linspace(1, image.shape[0] - 2, min(64, max(image.shape[0] - 2, 0))).astype(np.intp)
    if rows.size == 0:
        return _MIN_CONTRAST
    around = image[rows - 1].astype(np.float64) + image[rows + 1] - 2.0 * image[rows]
    return max(_MIN_CONTRAST, _MIN_CONTRAST_SIGMAS * robust_sigma(around.ravel()) / math.sqrt(6.0))


def smooth_columns(image: U8) -> F32:
    """The image, slightly smoothed along its columns, which vertical stripes allow; float32 (H, W, 3)."""
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, np.ones(1), np.array([0.25, 0.5, 0.25])), np.float32)


def find_edges(smooth: F32, sigma_px: float, limit: float) -> tuple[ColorEdges, F32]:
    """Color edges of each row.

    Args:
        smooth: float32 (H, W, 3), from :func:`smooth_columns`.
        sigma_px: standard deviation of the Gaussian whose derivative finds the edges; a quarter of a stripe is good.
        limit: from :func:`contrast_limit`.

    Returns:
        The edges, and the contrast of the strongest channel around each pixel, float32 (H, W), gray levels.
    """
    height, width = smooth.shape[:2]
    kernel = cv2.getGaussianKernel(2 * math.ceil(3.0 * sigma_px) + 1, sigma_px)
    rows = np.ascontiguousarray(cv2.sepFilter2D(smooth, cv2.CV_32F, kernel, np.ones(1)))
    x_px = np.full((height, width // 2 + 1), np.nan, np.float32)
    changes = np.zeros((height, width // 2 + 1, 3), np.float32)
    counts = np.zeros(height, np.int32)
    contrast = np.empty((height, width), np.float32)
    block = max(1, round(_BLOCK_SIGMAS * sigma_px))
    reach = max(1, round(_WINDOW_SIGMAS / _BLOCK_SIGMAS))
    run_bands(_find, height, rows, sigma_px, limit, block, reach, x_px, changes, counts, contrast, min_rows=8)
    most = int(counts.max())
    return ColorEdges(x_px[:, :most].copy(), changes[:, :most].copy(), counts), contrast


@compiled(
    "void(int64, int64, float32[:, :, ::1], float64, float64, int64, int64, float32[:, ::1], float32[:, :, ::1],"
    " int32[::1], float32[:, ::1])"
)
def _find(
    first: int,
    last: int,
    rows: F32,
    sigma_px: float,
    limit: float,
    block: int,
    reach: int,
    x_px: F32,
    changes: F32,
    counts: I32,
    contrast: F32,
) -> None:
    width = rows.shape[1]
    blocks = -(-width // block)
    low, high = np.empty((blocks, 3), np.float32), np.empty((blocks, 3), np.float32)
    range_of = np.empty((blocks, 3), np.float32)
    strength = np.empty(width, np.float32)
    # of a step that is itself blurred about as much: its gradient is the step over sqrt(2 pi) sqrt(2) sigma
    scale = np.float32(math.sqrt(4.0 * math.pi) * sigma_px / 2.0)
    for y in range(first, last):
        row = rows[y]
        _extremes(row, block, low, high)
        _contrasts(low, high, reach, range_of)
        for x in range(width):
            own = range_of[x // block]
            largest = max(own[0], own[1], own[2])
            contrast[y, x] = largest
            strength[x] = 0.0
            if 0 < x < width - 1 and largest >= limit:
                most = np.float32(0)
                for c in range(3):
                    step = scale * (row[x + 1, c] - row[x - 1, c])
                    most = max(most, abs(step))
                    strength[x] += (step / max(own[c], _WEAK_CHANNEL * largest)) ** 2
                if most < _LEAST_STEP * limit:
                    strength[x] = 0.0
        number = 0
        for x in range(1, width - 1):
            before, here, after = strength[x - 1], strength[x], strength[x + 1]
            if here < _MIN_CHANGE * _MIN_CHANGE or here <= before or here < after:
                continue
            x_px[y, number] = x + (before - after) / (2.0 * (before - 2.0 * here + after))
            own = range_of[x // block]
            largest, most = max(own[0], own[1], own[2]), np.float32(0)
            for c in range(3):
                changes[y, number, c] = (row[x + 1, c] - row[x - 1, c]) / max(own[c], _WEAK_CHANNEL * largest)
                most = max(most, abs(changes[y, number, c]))
            for c in range(3):
                changes[y, number, c] /= most
            number += 1
        counts[y] = number


@compiled()
def _extremes(row: F32, block: int, low: F32, high: F32) -> None:
    """Minimum and maximum of each channel in each block of a row."""
    low[:] = np.inf
    high[:] = -np.inf
    for x in range(row.shape[0]):
        for c in range(3):
            low[x // block, c] = min(low[x // block, c], row[x, c])
            high[x // block, c] = max(high[x // block, c], row[x, c])


@compiled()
def _contrasts(low: F32, high: F32, reach: int, range_of: F32) -> None:
    """Maximum less minimum of each channel over ``reach`` blocks to either side."""
    for b in range(low.shape[0]):
        for c in range(3):
            least, most = low[b, c], high[b, c]
            for k in range(max(0, b - reach), min(low.shape[0], b + reach + 1)):
                least, most = min(least, low[k, c]), max(most, high[k, c])
            range_of[b, c] = most - least

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convergence: the shift of both images after which the subject lies at the screen."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.types import F32, U8

__all__ = ["Convergence", "common_columns", "converged", "subject_disparity"]

_STEP = 4  # rows and columns between the pixels that are counted
_CENTER = 0.5  # standard deviation of the weights of pixels, in half image sizes
_PEAK = 1 / 3  # height of a peak that may be the subject, of that of the highest one
_SMOOTHING = (1, 2, 3, 2, 1)


def subject_disparity(disparity_px: F32) -> int:
    """The disparity of the subject, whole pixels; 0 without valid disparities.

    The nearest peak of the histogram that is at least a third as high as the highest one. Bins are 1 px wide and
    smoothed over 5 px; pixels have the weight of a Gaussian around the center of the image.

    Args:
        disparity_px: float32 (H, W), NaN where invalid.
    """
    sampled = disparity_px[::_STEP, ::_STEP]
    valid = np.isfinite(sampled)
    if not valid.any():
        return 0
    bins = np.rint(sampled[valid]).astype(np.int64)
    rows, columns = (np.exp(-0.5 * (np.linspace(-1, 1, size) / _CENTER) ** 2) for size in sampled.shape)
    first = int(bins.min())
    counts = np.bincount(bins - first, weights=np.outer(rows, columns)[valid])
    smooth = np.convolve(counts, _SMOOTHING)  # two bins more on either side
    padded = np.pad(smooth, 1)
    is_peak = (smooth >= padded[:-2]) & (smooth > padded[2:]) & (smooth >= _PEAK * smooth.max())
    return int(np.flatnonzero(is_peak)[-1]) + first - len(_SMOOTHING) // 2


class Convergence:
    """The shift of the images of a stream: it follows the subject by at most one pixel per frame, so that it is steady.

    Attributes:
        shift_px: of the last frame; None before the first one.
    """

    def __init__(self) -> None:
        self.shift_px: int | None = None

    def restart(self) -> None:
        """A new stream begins."""
        self.shift_px = None

    def follow(self, disparity_px: F32) -> int:
        """The disparity that lies at the screen, for the next frame, whole pixels."""
        subject = subject_disparity(disparity_px)
        last = subject if self.shift_px is None else self.shift_px
        self.shift_px = last + max(-1, min(1, subject - last))
        return self.shift_px


def converged(left: U8, right: U8, shift_px: int) -> tuple[U8, U8]:
    """Both images moved towards each other, so that surfaces with the disparity ``shift_px`` are in the same columns.

    Columns that one of them lacks are black in both.

    Args:
        left, right: uint8 (H, W) or (H, W, 3).
        shift_px: whole pixels.

    Returns:
        Arrays of the same shapes.
    """
    to_left = shift_px // 2
    first, last = common_columns(left.shape[1], shift_px)
    moved = np.zeros_like(left), np.zeros_like(right)
    for image, out, offset in ((left, moved[0], to_left), (right, moved[1], to_left - shift_px)):
        out[:, first:last] = image[:, first + offset : last + offset]
    return moved


def common_columns(width: int, shift_px: int) -> tuple[int, int]:
    """First and last column, exclusive, that both images have after :func:`converged`."""
    offsets = (shift_px // 2, shift_px // 2 - shift_px)
    first, last = max(0, *(-each for each in offsets)), min(width, *(width - each for each in offsets))
    return min(first, width), max(last, min(first, width))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Anaglyphs: both images in one, for glasses with two color filters."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np

from stereo_depth_ros.config.stages import ANAGLYPH_FILTERS, ANAGLYPH_METHODS
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8
from stereo_depth_ros.views.color_order import as_bgr

__all__ = ["anaglyph", "anaglyph_matrix"]

_GRAY = (0.299, 0.587, 0.114)  # Rec. 601
_LEVELS = 16384  # of light between 0 and 1, finer than a gray level at the dark end

# Rows: red, green and blue of the anaglyph; columns: red, green and blue of the left image, then of the right one.
# Least squares in CIE XYZ, for the spectra of screens and filters; the values are those that the author publishes.
_DUBOIS: Mapping[str, tuple[tuple[float, ...], ...]] = {
    "red-cyan": (
        (0.456, 0.500, 0.176, -0.043, -0.088, -0.002),
        (-0.040, -0.038, -0.016, 0.378, 0.734, -0.018),
        (-0.015, -0.021, -0.005, -0.072, -0.113, 1.226),
    ),
    "green-magenta": (
        (-0.062, -0.158, -0.039, 0.529, 0.705, 0.024),
        (0.284, 0.668, 0.143, -0.016, -0.015, -0.065),
        (-0.015, -0.027, 0.021, 0.009, 0.075, 0.937),
    ),
    "amber-blue": (
        (1.062, -0.205, 0.299, -0.016, -0.123, -0.017),
        (-0.026, 0.908, 0.068, 0.006, 0.062, -0.017),
        (-0.038, -0.173, 0.022, 0.094, 0.185, 0.911),
    ),
}
# Of each pair of filters: the channel that one filter passes alone, and the image that is seen through it (0 left).
_ALONE: Mapping[str, tuple[int, int]] = {"red-cyan": (0, 0), "green-magenta": (1, 0), "amber-blue": (2, 1)}
# What replaces a channel that is seen alone (optimized), of red, green and blue; green has most of the lightness
_REPLACED = {0: (0.0, 0.7, 0.3), 1: (0.25, 0.5, 0.25), 2: (0.3, 0.7, 0.0)}


def anaglyph(left: U8, right: U8, method: str = "dubois", filters: str = "red-cyan") -> U8:
    """Both images in one: each is seen through its own filter.

    A linear combination of the colors of both, :func:`anaglyph_matrix`, cut to 0..255; of gray levels as they are
    stored, and of linear light (sRGB) with ``dubois``.

    Args:
        left, right: uint8 (H, W) or (H, W, 3) BGR, converged.
        method: true, gray, color, half-color, optimized or dubois.
        filters: left and right: red-cyan, green-magenta or amber-blue.

    Returns:
        uint8 (H, W, 3), BGR.

    Raises:
        ConfigError: unknown method or filters.
        ImageError: the sizes differ.
    """
    matrix = anaglyph_matrix(method, filters)
    if left.shape[:2] != right.shape[:2]:
        raise ImageError(
            f"left {left.shape[:2]} and right {right.shape[:2]} differ in size",
            subject="anaglyph",
            value=right.shape[:2],
            limit=left.shape[:2],
            remedy="use images of one pair",
        )
    of_bgr = np.ascontiguousarray(matrix.reshape(3, 2, 3)[::-1, :, ::-1].reshape(3, 6), np.float32)
    light, level = _curves(method == "dubois")
    out = np.empty((*left.shape[:2], 3), np.uint8)
    run_bands(_mix, len(out), as_bgr(left), as_bgr(right), of_bgr, light, level, out)
    return out


def anaglyph_matrix(method: str, filters: str) -> F64:
    """Red, green and blue of an anaglyph from those of the left, then the right image: float64 (3, 6).

    ``true`` has each image in gray, without green where a filter passes green and another channel; ``gray`` has it in
    all channels; ``color`` keeps the channels of each image; ``half-color`` has gray in the channel that one filter
    passes alone; ``optimized`` has other channels there, since a red surface would be bright for one side and dark for
    the other: 0.7 green and 0.3 blue for red (P. Wimmer 2001), 0.7 green and 0.3 red for blue, half of its own and a
    quarter of each other one for green. ``dubois``: E. Dubois, A projection method to generate anaglyph stereo images,
    ICASSP 2001.

    Raises:
        ConfigError: unknown method or filters.
    """
    for name, value, choices in (("anaglyph", method, ANAGLYPH_METHODS), ("filters", filters, ANAGLYPH_FILTERS)):
        if value not in choices:
            raise ConfigError(
                f"{name} {value!r} is not one of {', '.join(choices)}",
                value=value,
                limit=choices,
                remedy="use one of them",
                settings=(name,),
            )
    if method == "dubois":
        return np.array(_DUBOIS[filters])
    alone, side = _ALONE[filters]
    matrix = np.zeros((3, 2, 3))
    for channel in range(3):
        image = matrix[channel, side if channel == alone else 1 - side]
        if method in ("true", "gray") or (method == "half-color" and channel == alone):
            image[:] = 0.0 if method == "true" and channel == 1 != alone else _GRAY
        elif method == "optimized" and channel == alone:
            image[:] = _REPLACED[channel]
        else:
            image[channel] = 1.0
    return matrix.reshape(3, 6)


@functools.cache
def _curves(is_light: bool) -> tuple[F32, U8]:
    """Value 0..1 of each gray level, float32 (256,), and the gray level of each of the values, uint8 (_LEVELS + 1,)."""
    level, value = np.arange(256) / 255, np.arange(_LEVELS + 1) / _LEVELS
    if is_light:  # IEC 61966-2-1
        level = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return level.astype(np.float32), np.rint(255 * value).astype(np.uint8)


_IMAGE = "Array(uint8, 3, 'C', readonly=True)"


@compiled(f"void(int64, int64, {_IMAGE}, {_IMAGE}, float32[:, ::1], float32[::1], uint8[::1], uint8[:, :, ::1])")
def _mix(first: int, last: int, left: U8, right: U8, matrix: F32, light: F32, level: U8, out: U8) -> None:
    top = np.float32(len(level) - 1)
    half = np.float32(0.5)
    for y in range(first, last):
        for x in range(out.shape[1]):
            a, b, c = light[left[y, x, 0]], light[left[y, x, 1]], light[left[y, x, 2]]
            d, e, f = light[right[y, x, 0]], light[right[y, x, 1]], light[right[y, x, 2]]
            for k in range(3):
                of_left = matrix[k, 0] * a + matrix[k, 1] * b + matrix[k, 2] * c
                value = top * (of_left + matrix[k, 3] * d + matrix[k, 4] * e + matrix[k, 5] * f) + half
                out[y, x, k] = level[int(min(max(value, np.float32(0)), top))]

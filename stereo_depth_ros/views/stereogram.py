# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Single-image stereograms: a pattern whose repetitions show the depth of a disparity map without glasses."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.views.color_order import as_bgr
from stereo_depth_ros.views.interpolation import dense_disparity

__all__ = ["separations", "stereogram"]

I32: TypeAlias = npt.NDArray[np.int32]

_FAR_SHARE = 1 / 7  # of the width: repetitions of the background
_NEAR_SHARE = 0.8  # of the background's: mu = 1/3
_NEAREST = (2 - 2 * _NEAR_SHARE) / (2 - _NEAR_SHARE)  # mu
_NARROWEST_PX = 8
_MULTIPLIER, _INCREMENT = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x9E3779B97F4A7C15)
_S31, _S40 = np.uint64(31), np.uint64(40)


def stereogram(disparity_px: F32, texture: U8 | None = None, *, far_px: int | None = None, seed: int = 1) -> U8:
    """A stereogram of a disparity map, of random dots or a texture, to be viewed with parallel lines of sight.

    Two pixels that show the same point to both sides have the same color; they are :func:`separations` apart, around
    the point. Points that are hidden from one side by nearer ones are not constrained.

    H. W. Thimbleby, S. Inglis, I. H. Witten: Displaying 3D images: algorithms for single-image random-dot stereograms,
    IEEE Computer 27(10), 1994.

    Args:
        disparity_px: float32 (H, W), NaN where invalid, which becomes background.
        texture: uint8 (h, w) or (h, w, 3) BGR, repeated; None draws black and white dots.
        far_px: distance of two repetitions of the background, px; None is a seventh of the width.
        seed: of the dots.

    Returns:
        uint8 (H, W), or (H, W, 3) BGR with a texture in color.

    Raises:
        ConfigError: the repetitions are too narrow, or wider than the image.
        ImageError: an empty texture.
    """
    separation, far = separations(disparity_px, far_px)
    if texture is not None and not texture.size:
        raise ImageError("texture has no pixels", value=texture.shape, limit="(h, w)", remedy="use another image")
    height, width = separation.shape
    columns = np.empty((height, width), np.int32)
    run_bands(_link_rows, height, separation, far, columns)
    if texture is None:
        dots = np.empty((height, width), np.uint8)
        run_bands(_draw_dots, height, columns, np.uint64(seed), dots)
        return dots
    rows = np.arange(height)[:, None] % len(texture)
    # The pattern fills one repetition of the background: its columns are scaled to that width.
    along = (columns % far) * texture.shape[1] // far
    pattern = texture if texture.ndim == 2 else as_bgr(texture)
    return np.ascontiguousarray(pattern[rows, along])


def separations(disparity_px: F32, far_px: int | None = None) -> tuple[F32, int]:
    """Distance of the two pixels of each point, float32 (H, W), px, and that of the background.

    Linear in the disparity: 0.8 of the background's for the nearest, as of a screen and a background at equal
    distances, and the nearest point a third of the way in front of the background (mu = 1/3).

    Raises:
        ConfigError: the repetitions are too narrow, or wider than the image.
    """
    far = round(_FAR_SHARE * disparity_px.shape[1]) if far_px is None else far_px
    if not _NARROWEST_PX <= far <= disparity_px.shape[1] // 2:
        raise ConfigError(
            f"repetitions are {far} px wide, {_NARROWEST_PX} px to half of the {disparity_px.shape[1]} columns are "
            "possible",
            value=far,
            limit=(_NARROWEST_PX, disparity_px.shape[1] // 2),
            remedy="use a wider disparity map",
        )
    dense = dense_disparity(disparity_px)
    low, high = float(dense.min()), float(dense.max())
    nearness = (dense - np.float32(low)) / np.float32(max(high - low, 1e-6))
    return np.float32(far) * (1 - np.float32(1 - _NEAR_SHARE) * nearness), far


@compiled("void(int64, int64, float32[:, ::1], int64, int32[:, ::1])")
def _link_rows(first: int, last: int, separation: F32, far: int, columns: I32) -> None:
    """For each pixel the column of the rightmost pixel that it is equal to."""
    width = separation.shape[1]
    distance = np.float32(2 * far)  # of the two sides, px; the background is as far behind the screen as they before
    same = np.empty(width, np.int64)
    depth = np.empty(width, np.float32)  # mu z of the paper: 0 at the background
    nearest = np.float32(_NEAREST)
    for y in range(first, last):
        for x in range(width):
            s = separation[y, x]
            same[x] = x
            depth[x] = (distance - np.float32(2) * s) / (distance - s)
        for x in range(width):
            s = int(np.rint(separation[y, x]))
            left = x - s // 2
            right = left + s
            if left < 0 or right >= width:
                continue
            is_hidden, t, line = False, 0, depth[x]
            while not is_hidden and line < nearest:
                t += 1
                line = depth[x] + np.float32(2 * t) * (np.float32(2) - depth[x]) / distance
                is_hidden = (x >= t and depth[x - t] >= line) or (x + t < width and depth[x + t] >= line)
            if is_hidden:
                continue
            k = same[left]
            while k != left and k != right:
                if k < right:
                    left = k
                else:
                    left = right
                    right = k
                k = same[left]
            same[left] = right
        for x in range(width - 1, -1, -1):  # same[x] is x or lies to the right
            columns[y, x] = x if same[x] == x else columns[y, same[x]]


@compiled("void(int64, int64, int32[:, ::1], uint64, uint8[:, ::1])")
def _draw_dots(first: int, last: int, columns: I32, seed: np.uint64, dots: U8) -> None:
    for y in range(first, last):
        for x in range(columns.shape[1]):
            key = (np.uint64(y) << np.uint64(32)) + np.uint64(columns[y, x]) + seed * _INCREMENT
            key = (key ^ (key >> _S31)) * _MULTIPLIER
            key = (key ^ (key >> _S31)) * _MULTIPLIER
            dots[y, x] = np.uint8(255) if (key >> _S40) & np.uint64(1) else np.uint8(0)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""View interpolation: the image of a camera between the two of a rectified pair, or somewhat beside them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.errors import ConfigError, ImageError
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.matching.filters.hole_filling import fill_holes

__all__ = ["POSITIONS", "dense_disparity", "interpolate_view", "right_disparity"]

POSITIONS = (-0.5, 1.5)  # of the camera: 0 is the left one, 1 the right one
_JUMP_PX = np.float32(1.0)  # a larger difference of two neighbors in a row is a depth edge
_CONTRAST = np.float32(16.0)  # gray levels between foreground and background below which alpha is not estimated
_LEAST_SHARE = np.float32(0.001)  # of the farther camera: what the nearer one does not see still comes from it
_EMPTY = np.float32(-np.inf)
_NONE, _HALF, _ONE, _WHITE = np.float32(0), np.float32(0.5), np.float32(1), np.float32(255)

_IMAGE, _MAP = "Array(uint8, 3, 'C', readonly=True)", "Array(float32, 2, 'C', readonly=True)"


def interpolate_view(
    left: U8, right: U8, disparity_px: F32, position: float, right_disparity_px: F32 | None = None
) -> U8:
    """The image of a camera on the line through both cameras, after Zitnick et al. 2004 in a simple form.

    Both images are warped by their disparities, x' = x_left - p d = x_right + (1 - p) d, nearer surfaces in front.
    Where both show the same surface, they are blended by 1 - p and p; else the nearer surface wins. The two pixels at a
    depth edge are split into foreground, background and alpha, and the foreground is drawn over what is behind it.
    What neither camera sees continues the background beside it. One disparity map is enough: that of the right image
    follows from it.

    C. L. Zitnick, S. B. Kang, M. Uyttendaele, S. Winder, R. Szeliski: High-quality video view interpolation using a
    layered representation, SIGGRAPH 2004.

    Args:
        left, right: uint8 (H, W) or (H, W, 3), rectified.
        disparity_px: float32 (H, W), x_left - x_right of the left pixels, NaN where invalid.
        position: p of the camera, 0 left, 1 right, from -0.5 to 1.5.
        right_disparity_px: x_left - x_right of the right pixels; None derives them.

    Returns:
        uint8 of the shape of ``left``.

    Raises:
        ImageError: the sizes differ, or one image has color and the other has not.
        ConfigError: the position is outside its range.
    """
    _check(left, right, disparity_px, right_disparity_px, position)
    left_d = dense_disparity(disparity_px)
    right_d = right_disparity(left_d) if right_disparity_px is None else dense_disparity(right_disparity_px)
    height, width = left.shape[:2]
    out = np.empty((height, width, left.size // (height * width)), np.uint8)
    images = (np.ascontiguousarray(image).reshape(out.shape) for image in (left, right))
    run_bands(_interpolate, height, *images, left_d, right_d, np.float32(position), out)
    return out.reshape(left.shape)


def dense_disparity(disparity_px: F32) -> F32:
    """A disparity for every pixel, float32 (H, W): holes have that of the background beside them; 0 without any."""
    dense = np.ascontiguousarray(np.where(np.isfinite(disparity_px), disparity_px, np.float32(np.nan)))
    fill_holes(dense, np.zeros(dense.shape, np.uint8))
    dense[np.isnan(dense)] = 0
    return dense


def right_disparity(left_disparity_px: F32) -> F32:
    """Disparities of the right pixels, float32 (H, W), from those of all left pixels; the nearest one wins.

    What only the right camera sees has the disparity of the background beside it.
    """
    warped = np.empty_like(left_disparity_px)
    run_bands(_warp_disparity, len(warped), left_disparity_px, warped)
    return dense_disparity(warped)


def _check(left: U8, right: U8, disparity_px: F32, right_disparity_px: F32 | None, position: float) -> None:
    shapes = {"left": left.shape, "right": right.shape, "disparity": (*disparity_px.shape, *left.shape[2:])}
    if right_disparity_px is not None:
        shapes["right disparity"] = (*right_disparity_px.shape, *left.shape[2:])
    if len(set(shapes.values())) > 1:
        raise ImageError(
            f"shapes differ: {', '.join(f'{name} {shape}' for name, shape in shapes.items())}",
            subject="view",
            value=shapes,
            limit="one shape",
            remedy="use two images of one kind and the disparities of the left one",
        )
    if not POSITIONS[0] <= position <= POSITIONS[1]:
        raise ConfigError(
            f"position {position:g} is outside {POSITIONS[0]:g}..{POSITIONS[1]:g}",
            value=position,
            limit=POSITIONS,
            remedy="0 is the left camera, 1 the right one",
            settings=("position",),
        )


class _Layer(NamedTuple):
    """A row of pixels, float32.

    Attributes:
        color: (W, C), gray levels.
        disparity: (W,), -inf where empty.
        alpha: (W,), share of the pixel that it covers, 0..1.
        weight: (W,), share of the color that the camera has seen and that was not extrapolated, above 0.
    """

    color: F32
    disparity: F32
    alpha: F32
    weight: F32


@compiled()
def _layer(width: int, channels: int) -> _Layer:
    ones = np.ones((2, width), np.float32)
    return _Layer(np.empty((width, channels), np.float32), np.empty(width, np.float32), ones[0], ones[1])


@compiled(allocates=False)
def _is_joined(disparity: F32, x: int, other: int) -> bool:
    """Whether two pixels, of which the other one may be outside of the row, belong to one surface."""
    return 0 <= other < len(disparity) and abs(disparity[other] - disparity[x]) <= _JUMP_PX


@compiled(allocates=False)
def _level(level: np.float32) -> np.float32:
    """A gray level within its range."""
    return min(max(level, _NONE), _WHITE)


@compiled(allocates=False)
def _split(image: U8, disparity: F32, far: _Layer, near: _Layer) -> None:
    """Split a row of a camera: at depth edges the foreground goes into the near layer, over the background."""
    width, channels = image.shape
    for x in range(width):
        far.disparity[x] = disparity[x]
        far.weight[x] = _ONE
        near.disparity[x] = _EMPTY
        for c in range(channels):
            far.color[x, c] = image[x, c]
    for x in range(width - 1):
        if not _is_joined(disparity, x, x + 1):
            step = 1 if disparity[x] < disparity[x + 1] else -1
            _split_edge(image, disparity, x if step > 0 else x + 1, step, far, near)


@compiled(allocates=False)
def _split_edge(image: U8, disparity: F32, behind: int, step: int, far: _Layer, near: _Layer) -> None:
    """Split the pixels on both sides of an edge by their neighbors, whose colors are those of one surface."""
    front = behind + step
    background = behind - step if _is_joined(disparity, behind, behind - step) else behind
    foreground = front + step if _is_joined(disparity, front, front + step) else front
    contrast = np.float32(0)
    for c in range(image.shape[1]):
        near.color[foreground, c] = image[foreground, c]
        difference = near.color[foreground, c] - np.float32(image[background, c])
        contrast += difference * difference
    near.disparity[foreground], near.alpha[foreground] = disparity[foreground], _ONE
    for x in (behind, front):
        if x in (background, foreground):
            continue
        alpha = _NONE if x == behind else _ONE
        if contrast > _CONTRAST * _CONTRAST * np.float32(image.shape[1]):
            alpha = np.float32(0)
            for c in range(image.shape[1]):
                base = np.float32(image[background, c])
                alpha += (np.float32(image[x, c]) - base) * (near.color[foreground, c] - base) / contrast
            alpha = min(max(alpha, _NONE), _ONE)
        near.disparity[x], near.alpha[x] = disparity[foreground], alpha
        far.disparity[x], far.weight[x] = disparity[background], _ONE if alpha == 0 else _LEAST_SHARE
        for c in range(image.shape[1]):
            mixed, base, top = np.float32(image[x, c]), np.float32(image[background, c]), near.color[foreground, c]
            far.color[x, c] = base if alpha >= _HALF else _level((mixed - alpha * top) / (_ONE - alpha))
            near.color[x, c] = top if alpha < _HALF else _level((mixed - (_ONE - alpha) * base) / alpha)


@compiled(allocates=False)
def _warp(source: _Layer, shift: np.float32, out: _Layer) -> None:
    """Draw a row at x - shift d: cubic between neighbors (Catmull and Rom 1974), the nearest surface wins."""
    width, channels = source.color.shape
    for t in range(width):
        out.disparity[t] = _EMPTY
    for x in range(width - 1):
        d0, d1 = source.disparity[x], source.disparity[x + 1]
        if not abs(d1 - d0) <= _JUMP_PX:  # a depth edge, or empty
            continue
        begin, end = np.float32(x) - shift * d0, np.float32(x + 1) - shift * d1
        first, last = max(int(np.ceil(begin)), 0), min(int(np.floor(end)), width - 1)
        if first > last or end <= begin:
            continue
        before = x - 1 if _is_joined(source.disparity, x, x - 1) else x
        after = x + 2 if _is_joined(source.disparity, x + 1, x + 2) else x + 1
        for t in range(first, last + 1):
            u = (np.float32(t) - begin) / (end - begin)
            d = d0 + u * (d1 - d0)
            if d < out.disparity[t]:
                continue
            out.disparity[t] = d
            out.alpha[t] = source.alpha[x] + u * (source.alpha[x + 1] - source.alpha[x])
            out.weight[t] = source.weight[x] + u * (source.weight[x + 1] - source.weight[x])
            v = _ONE - u
            w0, w3 = -_HALF * u * v * v, -_HALF * v * u * u
            w1, w2 = v - np.float32(2) * w0 + w3, u - np.float32(2) * w3 + w0
            for c in range(channels):
                out.color[t, c] = (
                    w0 * source.color[before, c]
                    + w1 * source.color[x, c]
                    + w2 * source.color[x + 1, c]
                    + w3 * source.color[after, c]
                )


@compiled(allocates=False)
def _mixed(a: np.float32, b: np.float32, share: np.float32) -> np.float32:
    """a with share 0, whatever b is, and b with share 1, whatever a is."""
    if share == 0:
        return a
    return b if share == 1 else a + share * (b - a)


@compiled(allocates=False)
def _blend(a: _Layer, b: _Layer, position: np.float32, out: _Layer) -> None:
    """Both cameras, weighted by distance and by what they have seen; where surfaces differ, the nearer one."""
    for t in range(len(out.disparity)):
        da, db = a.disparity[t], b.disparity[t]
        out.disparity[t] = max(da, db)
        if out.disparity[t] == _EMPTY:
            continue
        weight_a, weight_b = (_ONE - position) * a.weight[t], position * b.weight[t]
        share = weight_b / (weight_a + weight_b)
        if db < da - _JUMP_PX:
            share = _NONE
        elif da < db - _JUMP_PX:
            share = _ONE
        out.alpha[t] = _mixed(a.alpha[t], b.alpha[t], share)
        for c in range(out.color.shape[1]):
            out.color[t, c] = _mixed(a.color[t, c], b.color[t, c], share)


@compiled(allocates=False)
def _fill(layer: _Layer) -> None:
    """Fill holes by the mirrored surface beside them, the farther one of two."""
    width = len(layer.disparity)
    begin = 0  # of the pixels after the last drawn one
    for x in range(width + 1):
        if x < width and layer.disparity[x] == _EMPTY:
            continue
        if begin < x and (begin > 0 or x < width):
            from_left = begin > 0 and (x == width or layer.disparity[begin - 1] <= layer.disparity[x])
            edge = begin - 1 if from_left else x
            for t in range(begin, x):
                source = 2 * edge + 1 - t if from_left else 2 * edge - 1 - t
                if not _is_joined(layer.disparity, edge, source):
                    source = edge
                for c in range(layer.color.shape[1]):
                    layer.color[t, c] = layer.color[source, c]
            layer.disparity[begin:x] = layer.disparity[edge]
        begin = x + 1


@compiled(f"void(int64, int64, {_IMAGE}, {_IMAGE}, {_MAP}, {_MAP}, float32, uint8[:, :, ::1])")
def _interpolate(
    first: int, last: int, left: U8, right: U8, left_d: F32, right_d: F32, position: np.float32, out: U8
) -> None:
    width, channels = left.shape[1:]
    sources = (_layer(width, channels), _layer(width, channels))  # far and near
    warped = (_layer(width, channels), _layer(width, channels), _layer(width, channels), _layer(width, channels))
    blended = (_layer(width, channels), _layer(width, channels))
    view, front = blended
    between = min(max(position, _LEAST_SHARE), _ONE - _LEAST_SHARE)
    for y in range(first, last):
        for side in range(2):
            image, disparity = (left[y], left_d[y]) if side == 0 else (right[y], right_d[y])
            _split(image, disparity, sources[0], sources[1])
            for depth in range(2):
                _warp(sources[depth], position - np.float32(side), warped[2 * side + depth])
        for depth in range(2):
            _blend(warped[depth], warped[2 + depth], between, blended[depth])
        _fill(view)
        for t in range(width):
            alpha = front.alpha[t] if front.disparity[t] > view.disparity[t] + _HALF * _JUMP_PX else _NONE
            for c in range(channels):
                level = view.color[t, c]
                if alpha > 0:
                    level += alpha * (front.color[t, c] - level)
                out[y, t, c] = np.uint8(_level(level) + _HALF)


@compiled(f"void(int64, int64, {_MAP}, float32[:, ::1])")
def _warp_disparity(first: int, last: int, left_d: F32, right_d: F32) -> None:
    width = left_d.shape[1]
    source, warped = _layer(width, 0), _layer(width, 0)
    for y in range(first, last):
        source.disparity[:] = left_d[y]
        _warp(source, _ONE, warped)
        right_d[y] = warped.disparity

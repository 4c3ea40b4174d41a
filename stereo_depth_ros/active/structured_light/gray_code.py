# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gray codes: bits by direct and global light, the finest bit that the camera resolves, and edges between codes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.active.structured_light.noise import Noise
from stereo_depth_ros.active.structured_light.outliers import mark_outliers
from stereo_depth_ros.active.structured_light.patterns import Pattern
from stereo_depth_ros.core.bands import run_bands
from stereo_depth_ros.core.kernels import compiled
from stereo_depth_ros.core.types import F32, F64, U8, Reason

__all__ = ["GrayBits", "decode_gray"]

I16 = npt.NDArray[np.int16]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]

_TILE_PX = 8  # the bits that are resolved are found for tiles of this size, and their neighbors
_RESOLVED = 0.2  # of a bit: least share of its mean difference in the largest one of all bits
_MEAN_OF_NOISE = 0.8  # mean size of a normal variable, relative to its standard deviation
_FINE_BITS = 3  # direct light is found from this number of bits, the finest that are resolved
_BLURRED_BITS = 2  # more than usual may be unresolved where the projector is out of focus
_LIT = 5.0  # least direct light, in standard deviations of a difference
_UNLIT = 4.0  # less is the range of the noise
_CERTAIN = 3.0  # least difference of a bit, in standard deviations
_CERTAIN_SHARE = 0.1  # and relative to the direct light
_MOST_CELLS = 3  # between neighbors
_LEAST_EDGE_PX = 0.05  # standard deviation of the place of an edge without noise

_SHADOW, _TEXTURE, _UNIQUENESS = int(Reason.SHADOW), int(Reason.TEXTURE), int(Reason.UNIQUENESS)
_STACK, _FLOATS, _BYTES, _WHOLE = "uint8[:, :, ::1]", "float32[:, ::1]", "uint8[:, ::1]", "int32[:, ::1]"


@dataclass(frozen=True, eq=False)
class GrayBits:
    """The images of a Gray code of one axis.

    Attributes:
        images: int64 (bits, 2): number of the image of each bit and of its inverse, the finest bit first; -1 where
            there is none.
        white, black: numbers of these images, -1 where there is none.
        finest: of the bits.
        cell_px, offset_px: those of the patterns.
        length_px: number of coordinates.
    """

    images: I64
    white: int
    black: int
    finest: int
    cell_px: int
    offset_px: int
    length_px: int

    @staticmethod
    def of_patterns(patterns: Mapping[int, Pattern], white: int | None, black: int | None, length_px: int) -> GrayBits:
        """The bits of the patterns, by number of their image, of one axis."""
        bits = sorted({pattern.bit for pattern in patterns.values()})
        images = np.full((bits[-1] - bits[0] + 1, 2), -1, np.int64)
        for number, pattern in patterns.items():
            images[pattern.bit - bits[0], int(pattern.inverse)] = number
        first = next(iter(patterns.values()))
        return GrayBits(
            images,
            -1 if white is None else white,
            -1 if black is None else black,
            bits[0],
            first.cell_px,
            first.offset_px,
            length_px,
        )


def decode_gray(stack: U8, bits: GrayBits, noise: Noise, reasons: U8, refine: bool = True) -> tuple[F32, F32]:
    """Coordinate of each pixel from a Gray code, to a part of a cell where edges are near.

    Light that other surfaces reflect changes the level of a bit. A pixel whose direct light, the range of its levels
    under fine stripes, is above its global light is read by the sign of the difference to the inverse; another one only
    where both levels exclude the other reading (Nayar, Krishnan, Grossberg and Raskar 2006; Xu and Aliaga 2007).
    Doubtful is a bit whose difference is within the noise or small; one such bit is accepted where the finer ones are
    those of the edge at which it changes, since both codes are neighbors then. Bits finer than the camera resolves are
    left out, so that a cell is larger there.

    Args:
        stack: uint8 (N, H, W), the images.
        bits: which image shows what.
        noise: of the gray levels.
        reasons: uint8 (H, W), receives the reasons of the pixels without a coordinate.
        refine: interpolate between the edges of the codes; else the coordinates are centers of cells.

    Returns:
        Coordinate and its standard deviation, float32 (H, W), projector px; NaN where there is none.
    """
    height, width = stack.shape[1:]
    levels, usual = _resolved(stack, bits, noise)
    codes = np.empty((height, width), np.int32)
    direct = np.empty((height, width), np.float32)
    where = (bits.images, bits.white, bits.black)
    images = max(map(_variance, bits.images))
    variance = np.array([images * noise.variance, images * noise.per_level])
    size = (bits.length_px + bits.offset_px + bits.cell_px - 1) // bits.cell_px
    run_bands(_decode_rows, height, stack, *where, bits.finest, size, variance, levels, usual, codes, direct, reasons)
    mark_outliers(
        (2 * codes.astype(np.int64) + 1) << _of_pixels(levels, codes.shape), (2 * _MOST_CELLS) << (usual + 1), reasons
    )
    coordinate, sigma_px = np.empty((2, height, width), np.float32)
    along_y = _changes(codes, reasons, 0) > _changes(codes, reasons, 1)
    lines = width if along_y else height
    geometry = (bits.finest, bits.cell_px, bits.offset_px, variance, along_y, refine)
    run_bands(_refine_lines, lines, stack, *where, *geometry, levels, codes, direct, reasons, coordinate, sigma_px)
    return coordinate, sigma_px


def _of_pixels(levels: I64, shape: tuple[int, ...]) -> I64:
    """The level of each pixel."""
    rows = np.repeat(levels, _TILE_PX, axis=0)[: shape[0]]
    pixels: I64 = np.repeat(rows, _TILE_PX, axis=1)[:, : shape[1]]
    return pixels


def _changes(codes: I32, reasons: U8, axis: int) -> int:
    """Number of changes of the code along an axis of the image."""
    valid = reasons == 0
    first, second = (slice(None, -1), slice(1, None))
    before, after = (first, second) if axis == 0 else ((slice(None), first), (slice(None), second))
    return int(np.count_nonzero((codes[before] != codes[after]) & valid[before] & valid[after]))


def _resolved(stack: U8, bits: GrayBits, noise: Noise) -> tuple[I64, int]:
    """Number of fine bits that the camera does not resolve: int64 of each tile, and the usual one.

    All bits, where there is no direct light.
    """
    height, width = stack.shape[1:]
    count = len(bits.images)
    shape = (-(-height // _TILE_PX), -(-width // _TILE_PX))
    means = np.empty((count, *shape), np.float32)
    run_bands(_mean_differences, shape[0], stack, bits.images, bits.white, bits.black, means, min_rows=8)
    floor = _MEAN_OF_NOISE * np.sqrt([noise.variance * _variance(pair) for pair in bits.images])
    smooth = np.stack([cv2.blur(mean, (3, 3), borderType=cv2.BORDER_REPLICATE) for mean in means])
    amplitude = np.sqrt(np.maximum(smooth**2 - np.float32(floor[:, None, None] ** 2), 0))
    clear = amplitude >= _RESOLVED * np.max(amplitude, axis=0)
    # from coarse to fine, up to the first that is not clear
    chain = np.logical_and.accumulate(clear[::-1], axis=0)
    levels: I64 = count - np.count_nonzero(chain, axis=0)
    usual = _weighted_median(levels, np.max(amplitude, axis=0))
    # only light from other surfaces, which has no fine detail, is blurred more
    levels[levels > usual + _BLURRED_BITS] = count
    return np.maximum(levels, usual), usual


def _weighted_median(values: I64, weights: F32) -> int:
    totals = np.cumsum(np.bincount(values.ravel(), weights.ravel()))
    return int(np.searchsorted(totals, 0.5 * totals[-1]))


def _variance(pair: npt.NDArray[np.int64]) -> float:
    """Variance of the difference of a bit for noise of 1: two images, or twice one minus white and black."""
    return 2.0 if pair.min() >= 0 else 6.0


@compiled(allocates=False)
def _level(stack: U8, number: int, y: int, x: int) -> Any:
    """A gray level as a signed number: for numba, int() of an unsigned one is unsigned."""
    return np.int64(stack[number, y, x])


@compiled(allocates=False)
def _pair(stack: U8, images: I64, white: int, black: int, k: int, y: int, x: int) -> tuple[int, int]:
    """Levels under the pattern of a bit and under its inverse, whose sum is that of white and black."""
    direct, inverse = images[k, 0], images[k, 1]
    if direct >= 0 and inverse >= 0:
        return _level(stack, direct, y, x), _level(stack, inverse, y, x)
    both = _level(stack, white, y, x) + _level(stack, black, y, x)
    if direct >= 0:
        level = _level(stack, direct, y, x)
        return level, both - level
    level = _level(stack, inverse, y, x)
    return both - level, level


@compiled(allocates=False)
def _difference(stack: U8, images: I64, white: int, black: int, k: int, y: int, x: int) -> int:
    one, zero = _pair(stack, images, white, black, k, y, x)
    return one - zero


@compiled(f"void(int64, int64, {_STACK}, int64[:, ::1], int64, int64, float32[:, :, ::1])", allocates=False)
def _mean_differences(first: int, last: int, stack: U8, images: I64, white: int, black: int, means: F32) -> None:
    """Mean size of the difference of each bit over tiles; rows are those of tiles."""
    height, width = stack.shape[1], stack.shape[2]
    for k in range(images.shape[0]):
        for row in range(first, last):
            top, bottom = row * _TILE_PX, min(row * _TILE_PX + _TILE_PX, height)
            for column in range(means.shape[2]):
                left, right = column * _TILE_PX, min(column * _TILE_PX + _TILE_PX, width)
                total = 0
                for y in range(top, bottom):
                    for x in range(left, right):
                        total += abs(_difference(stack, images, white, black, k, y, x))
                means[k, row, column] = np.float32(total) / np.float32((bottom - top) * (right - left))


@compiled(allocates=False)
def _base(stack: U8, black: int, y: int, x: int) -> int:
    """Light that is there without the projector, and with a black pattern."""
    return _level(stack, black, y, x) if black >= 0 else 0


@compiled(allocates=False)
def _direct_and_global(
    stack: U8, images: I64, white: int, black: int, usual: int, level: int, y: int, x: int
) -> tuple[float, float, float]:
    """Direct and global light of white (Nayar et al. 2006, eq. 3 and 4, for half of the pixels lit), and the level."""
    low, high = 1024, -1024
    for k in range(usual, min(max(usual + _FINE_BITS, level + 1), images.shape[0])):
        one, zero = _pair(stack, images, white, black, k, y, x)
        low, high = min(low, one, zero), max(high, one, zero)
    return float(high - low), 2.0 * float(max(low - _base(stack, black, y, x), 0)), float(high)


@compiled(allocates=False)
def _is_edge(gray: int, bit: int) -> bool:
    """Whether both codes that differ in this bit are neighbors: the next finer bit is 1 and all others are 0."""
    below = gray & ((1 << bit) - 1)
    return below == (1 << bit) >> 1


@compiled(allocates=False)
def _binary(gray: int) -> int:
    code, shift = gray, gray >> 1
    while shift:
        code ^= shift
        shift >>= 1
    return code


@compiled(
    f"void(int64, int64, {_STACK}, int64[:, ::1], int64, int64, int64, int64, float64[::1], int64[:, ::1], int64, "
    f"{_WHOLE}, {_FLOATS}, {_BYTES})",
    allocates=False,
)
def _decode_rows(
    first: int,
    last: int,
    stack: U8,
    images: I64,
    white: int,
    black: int,
    finest: int,
    size: int,
    variance: F64,
    levels: I64,
    usual: int,
    codes: I32,
    direct: F32,
    reasons: U8,
) -> None:
    """Codes without the bits that are not resolved, direct light, and reasons.

    Args:
        finest: number of the first bit.
        size: number of codes.
        variance: of the difference of a bit, and its rise for each gray level: float64 (2,).
        usual: of the levels.
    """
    count = images.shape[0]
    for y in range(first, last):
        for x in range(stack.shape[2]):
            level = levels[y // _TILE_PX, x // _TILE_PX]
            codes[y, x] = 0
            if level >= count:
                reasons[y, x] |= _SHADOW
                continue
            light, reflected, brightest = _direct_and_global(stack, images, white, black, usual, level, y, x)
            direct[y, x] = light
            sigma = np.sqrt(variance[0] + variance[1] * brightest)
            if light < _LIT * sigma:
                reasons[y, x] |= _SHADOW if light < _UNLIT * sigma else _TEXTURE
                continue
            least = max(_CERTAIN * sigma, _CERTAIN_SHARE * light)
            gray, doubtful, doubts = 0, 0, 0
            for k in range(count - 1, level - 1, -1):
                one, zero = _pair(stack, images, white, black, k, y, x)
                certain = abs(one - zero) >= least
                if certain and light <= reflected:
                    dark, bright = min(one, zero) - _base(stack, black, y, x), max(one, zero)
                    certain = dark < light and bright - _base(stack, black, y, x) > reflected
                if not certain:
                    doubts += 1
                    doubtful = k - level
                gray |= int(one > zero) << (k - level)
            if doubts == 1 and not _is_edge(gray, doubtful):
                doubts = 2
            codes[y, x] = _binary(gray)
            if doubts > 1 or (int(codes[y, x]) << (level + finest)) >= size:
                reasons[y, x] |= _UNIQUENESS


@compiled(allocates=False)
def _edge(
    stack: U8,
    images: I64,
    white: int,
    black: int,
    levels: I64,
    codes: I32,
    direct: F32,
    variance: F64,
    y: int,
    x: int,
    v: int,
    u: int,
) -> tuple[float, float, float]:
    """The edge between a pixel and the next one: place 0..1, boundary in cells of level 0, sigma of the place.

    The boundary is -1 where both have one code, and -2 where they are not on one surface.
    """
    here, there = levels[y // _TILE_PX, x // _TILE_PX], levels[v // _TILE_PX, u // _TILE_PX]
    level = max(here, there)
    a, b = int(codes[y, x]) >> (level - here), int(codes[v, u]) >> (level - there)
    if a == b:
        return 0.5, -1.0, 0.0
    if abs(a - b) > _MOST_CELLS:
        return 0.5, -2.0, 0.0
    if abs(a - b) > 1:
        return 0.5, 0.5 * float((a + b + 1) << level), 0.3
    boundary = float(max(a, b) << level)
    changed = (a ^ (a >> 1)) ^ (b ^ (b >> 1))
    k = level
    while changed > 1:
        changed >>= 1
        k += 1
    before = float(_difference(stack, images, white, black, k, y, x)) / max(float(direct[y, x]), 1.0)
    after = float(_difference(stack, images, white, black, k, v, u)) / max(float(direct[v, u]), 1.0)
    if before * after >= 0.0:
        return 0.5, boundary, 0.3
    slope = abs(after - before)
    # the place is between two pixels, of which each has about half of the weight
    light = max(float(min(direct[y, x], direct[v, u])), 1.0)
    error = np.sqrt(variance[0] + variance[1] * light) / light / slope
    return before / (before - after), boundary, min(max(error, _LEAST_EDGE_PX), 0.5)


@compiled(allocates=False)
def _fill(
    line: int,
    start: int,
    end: int,
    at: float,
    u: float,
    slope: float,
    error: float,
    least: float,
    finest: int,
    cell_px: int,
    offset_px: int,
    along_y: bool,
    levels: I64,
    codes: I32,
    coordinate: F32,
    sigma_px: F32,
) -> None:
    """Coordinates of the pixels ``start`` to ``end`` of a line, on the slope through ``u`` at ``at``.

    Args:
        at, u, slope: pixel, and cells of level 0; with a slope of 0 the coordinate is the center of the cell.
        error: standard deviation of ``at``.
        least: of the standard deviation, relative to that of a place somewhere in the cell.
    """
    unit = float(cell_px) * float(1 << finest)
    for i in range(start, end + 1):
        y, x = (i, line) if along_y else (line, i)
        cells = float(1 << levels[y // _TILE_PX, x // _TILE_PX])
        low = float(codes[y, x]) * cells
        value = low + 0.5 * cells
        if slope != 0.0:
            value = min(max(u + slope * (i - at), low - 0.5 * cells), low + 1.5 * cells)
        coordinate[y, x] = value * unit - 0.5 - float(offset_px)
        sigma_px[y, x] = unit * max(abs(slope) * error, least * cells / np.sqrt(12.0))


@compiled(
    f"void(int64, int64, {_STACK}, int64[:, ::1], int64, int64, int64, int64, int64, float64[::1], boolean, boolean, "
    f"int64[:, ::1], {_WHOLE}, {_FLOATS}, {_BYTES}, {_FLOATS}, {_FLOATS})",
    allocates=False,
)
def _refine_lines(
    first: int,
    last: int,
    stack: U8,
    images: I64,
    white: int,
    black: int,
    finest: int,
    cell_px: int,
    offset_px: int,
    variance: F64,
    along_y: bool,
    refine: bool,
    levels: I64,
    codes: I32,
    direct: F32,
    reasons: U8,
    coordinate: F32,
    sigma_px: F32,
) -> None:
    """Coordinates by linear interpolation between the edges along lines, columns or rows of the image.

    A cell with an edge on one side only continues the slope of the cell behind that edge.
    """
    count = stack.shape[1] if along_y else stack.shape[2]
    place = (finest, cell_px, offset_px, along_y, levels, codes, coordinate, sigma_px)
    for line in range(first, last):
        # a run of pixels with one code begins at start, behind an edge or not; the one before may wait for a slope
        start, start_edge, start_at, start_u, start_error, slope = 0, False, 0.0, 0.0, 0.0, 0.0
        waiting = -1
        for i in range(count):
            y, x = (i, line) if along_y else (line, i)
            if reasons[y, x]:
                coordinate[y, x], sigma_px[y, x] = np.nan, np.nan
                start, start_edge, slope, waiting = i + 1, False, 0.0, -1
                continue
            edge, at, u, error = i + 1 < count, 0.5, -2.0, 0.0
            if edge:
                v, w = (i + 1, line) if along_y else (line, i + 1)
                edge = reasons[v, w] == 0
                if edge:
                    at, u, error = _edge(stack, images, white, black, levels, codes, direct, variance, y, x, v, w)
                    if u == -1.0:
                        continue
                    edge = u != -2.0
            at += i
            if edge and start_edge and u != start_u and at > start_at and refine:
                slope = (u - start_u) / (at - start_at)
                _fill(line, start, i, start_at, start_u, slope, max(error, start_error), 0.0, *place)
                if waiting >= 0:
                    _fill(line, waiting, start - 1, start_at, start_u, slope, start_error, 0.5, *place)
                waiting = -1
            elif start_edge and not edge and slope != 0.0:
                _fill(line, start, i, start_at, start_u, slope, start_error, 0.5, *place)
            else:
                _fill(line, start, i, 0.0, 0.0, 0.0, 0.0, 1.0, *place)
                waiting = start if edge and not start_edge else -1
            if not edge:
                slope, waiting = 0.0, -1
            start, start_edge, start_at, start_u, start_error = i + 1, edge, at, u, error

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Census transform, and its Hamming distances as matching costs."""

from __future__ import annotations

import numba
import numpy as np

from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import U8, U16
from stereo_depth_ros.core.vectors import (
    BYTES,
    add,
    load,
    maximum,
    mean,
    minimum,
    ones,
    quarter,
    repeat,
    store,
    subtract,
    subtract_saturated,
    union,
    where_less,
    xor,
)
from stereo_depth_ros.matching.costs.windows import TILE_ROWS, Windows, run_of

__all__ = [
    "CAP",
    "CENSUS_BITS",
    "CENSUS_PLANES",
    "CENSUS_WINDOW",
    "GRAY",
    "LARGEST_CAP",
    "LARGEST_COST",
    "MARGIN",
    "PLANES",
    "census_rows",
    "empty_census",
    "hamming_row",
    "padded_count",
    "quarter_half_quarter",
]

RADIUS_X, RADIUS_Y = 3, 2
CENSUS_WINDOW = (2 * RADIUS_X + 1, 2 * RADIUS_Y + 1)  # width, height
_OPPOSITE = {(-RADIUS_X, -RADIUS_Y), (RADIUS_X, RADIUS_Y)}  # corners without a bit, so that a code has 32 bits
NEIGHBORS = tuple(
    (i, j)
    for j in range(-RADIUS_Y, RADIUS_Y + 1)
    for i in range(-RADIUS_X, RADIUS_X + 1)
    if (i, j) != (0, 0) and (i, j) not in _OPPOSITE
)
CENSUS_BITS = len(NEIGHBORS)
CENSUS_PLANES = CENSUS_BITS // 8
GRAY, CAP = CENSUS_PLANES, CENSUS_PLANES + 1  # planes after those of the codes
PLANES = CENSUS_PLANES + 2
_WINDOW_ROWS = 2 * RADIUS_Y + 1
MARGIN = BYTES  # columns before and after the image, so that vectors may begin before it and end behind it
NEUTRAL_COST = np.uint8(CENSUS_BITS // 2)  # average cost of unrelated pixels
LARGEST_COST = np.uint8(255)  # of the disparities that only fill a vector: they never win

TEXTURE, LARGEST_CAP = 14, 12  # gray levels; a quarter of a difference is added to a cost
_TEXTURE, _LARGEST_CAP = np.uint8(TEXTURE), np.uint8(LARGEST_CAP)
_NOTHING, _ONE = np.uint8(0), np.uint8(1)
_SHARE_BITS, _HALF = np.uint32(16), np.uint32(1 << 15)  # of 1 / number of pairs, rounded


def padded_count(num_disparities: int) -> int:
    """Elements of a buffer for the costs of a pixel: whole vectors."""
    return -(-num_disparities // BYTES) * BYTES


def empty_census(*shape: int) -> U8:
    """Buffer of census codes of images of ``shape``, (..., H, W), for :func:`census_rows`."""
    *before, width = shape
    return np.zeros((*before, PLANES, width + 2 * MARGIN), np.uint8)


@compiled(allocates=False)
def _code_vector(window: tuple[U8, ...], x: int, codes: U8) -> None:
    """Codes of a vector of pixels from column x on, and what goes with them, of the rows around them."""
    nothing, bit_set = repeat(_NOTHING), repeat(_ONE)
    center = load(window[RADIUS_Y], x + RADIUS_X)
    darkest, brightest = center, center
    for plane in range(CENSUS_PLANES):
        code = nothing
        for bit in range(8 * plane, 8 * plane + 8):
            i, j = NEIGHBORS[bit]
            neighbor = load(window[RADIUS_Y + j], x + RADIUS_X + i)
            code = add(add(code, code), where_less(neighbor, center, bit_set, nothing))
            darkest, brightest = minimum(darkest, neighbor), maximum(brightest, neighbor)
        store(codes[plane], MARGIN + x, code)
    store(codes[GRAY], MARGIN + x, center)
    under = subtract_saturated(repeat(_TEXTURE), subtract(brightest, darkest))
    store(codes[CAP], MARGIN + x, minimum(add(under, mean(under, nothing)), repeat(_LARGEST_CAP)))


@compiled(numba.void(numba.int64, numba.int64, READ_ONLY_U8, numba.uint8[:, :, ::1]))
def census_rows(first: int, last: int, image: U8, codes: U8) -> None:
    """Census transform with a window of 7 x 5: a bit is set if the neighbor is darker than the center.

    Two opposite corners have no bit.

    Zabih and Woodfill, "Non-parametric local transforms for computing visual correspondence", ECCV 1994. The image
    is extended by its border pixels.

    Args:
        first, last: rows to write.
        image: uint8 (H, W).
        codes: uint8 (H, PLANES, MARGIN + W + MARGIN), eight bits of each code in a plane: many pixels in a vector.
            Plane ``GRAY`` gets the image itself and plane ``CAP`` what its differences may add to the costs, times 4:
            ``LARGEST_CAP`` where the window has hardly any texture, 0 where its gray levels span ``TEXTURE`` or more.
            What is in the margins afterwards is not defined.
    """
    height, width = image.shape
    rows = np.zeros((_WINDOW_ROWS, width + 2 * RADIUS_X + BYTES), np.uint8)  # row y is at y % _WINDOW_ROWS
    for y in range(first - RADIUS_Y, last + RADIUS_Y):
        row, copy = image[min(max(y, 0), height - 1)], rows[y % _WINDOW_ROWS]
        copy[:RADIUS_X] = row[0]
        copy[RADIUS_X : RADIUS_X + width] = row
        copy[RADIUS_X + width : 2 * RADIUS_X + width] = row[width - 1]
        middle = y - RADIUS_Y
        if middle >= first:
            top = middle - RADIUS_Y
            window = (
                rows[top % _WINDOW_ROWS],
                rows[(top + 1) % _WINDOW_ROWS],
                rows[(top + 2) % _WINDOW_ROWS],
                rows[(top + 3) % _WINDOW_ROWS],
                rows[(top + 4) % _WINDOW_ROWS],
            )
            for x in range(0, width, BYTES):
                _code_vector(window, x, codes[middle])


@compiled(allocates=False)
def _hamming(left: U8, x: int, right: U8, first: int, weak: bool, out: U8, out_at: int, size: int) -> None:
    """Distances of left pixel x to ``size`` right pixels from column ``first`` on, of the codes of a row.

    They are written to ``out`` from its element ``out_at`` on, counted over all dimensions.
    """
    pitch = right.shape[1]
    for k in range(0, size, BYTES):
        at = MARGIN + first + k
        distance = ones(xor(load(right, at), repeat(left[0, MARGIN + x])))
        for plane in range(1, CENSUS_PLANES):
            distance = add(distance, ones(xor(load(right, at + plane * pitch), repeat(left[plane, MARGIN + x]))))
        if weak:
            gray, own = load(right, at + GRAY * pitch), repeat(left[GRAY, MARGIN + x])
            difference = union(subtract_saturated(gray, own), subtract_saturated(own, gray))
            distance = add(distance, quarter(minimum(difference, repeat(left[CAP, MARGIN + x]))))
        store(out, out_at + k, distance)


@compiled(allocates=False, inlined=False)
def _mean_hamming(census: U8, y: int, x: int, first: int, sums: U16, out: U8) -> None:
    """Means over the pairs of the distances of left pixel (x, y) to the right pixels from column ``first`` on."""
    pairs = len(census)
    sums[:] = 0
    for n in range(pairs):
        _hamming(census[n, 0, y], x, census[n, 1, y], first, False, out, 0, out.size)
        for k in range(out.size):
            sums[k] = np.uint16(sums[k] + np.uint16(out[k]))
    share = np.uint32(((1 << 16) + pairs // 2) // pairs)
    for k in range(out.size):
        out[k] = np.uint8(np.uint32(np.uint32(sums[k]) * share + _HALF) >> _SHARE_BITS)


@compiled(allocates=False, inlined=False)
def _hamming_pixels(
    census: U8, y: int, start: int, stop: int, max_disparity: int, count: int, weak: bool, raw: U8, sums: U16
) -> None:
    """The costs of pixels start to stop of row y, some right pixels of which are outside; see :func:`hamming_row`."""
    width, size = census.shape[4] - 2 * MARGIN, raw.shape[1]
    left, right = census[0, 0, y], census[0, 1, y]
    for x in range(start, stop):
        here = raw[x + 1]
        at = x - max_disparity  # right column of index 0
        begin, end = min(max(-at, 0), count), max(min(width - at, count), 0)
        if begin >= end:
            here[:count] = NEUTRAL_COST
            here[count:] = LARGEST_COST
            continue
        first, last = begin // BYTES * BYTES, (end + BYTES - 1) // BYTES * BYTES
        if len(census) == 1:
            _hamming(left, x, right, at + first, weak, raw, (x + 1) * size + first, last - first)
        else:
            _mean_hamming(census, y, x, at + first, sums[first:last], here[first:last])
        if begin > 0:
            here[:begin] = min(here[begin], NEUTRAL_COST)
        if end < size:
            here[end:count] = min(here[end - 1], NEUTRAL_COST)
            here[count:] = LARGEST_COST


@compiled(allocates=False, inlined=False)
def hamming_row(
    census: U8, y: int, max_disparity: int, count: int, weak: bool, windows: Windows, raw: U8, sums: U16
) -> None:
    """Matching costs of one row: Hamming distances, before any smoothing.

    Of several pairs of one scene the distance is the mean over the pairs, rounded to whole bits.

    Index k of a cost counts down from the largest disparity, so that it increases along the right image. Outside the
    right image the distance of the border pixel is repeated, at most ``NEUTRAL_COST``: a constant would favor the
    disparities inside, and paths would propagate that bias over images without texture. Elements from ``count`` on are
    ``LARGEST_COST``.

    Where the left image has hardly any texture, a quarter of the gray difference is added, up to a cap: a slow gradient
    says more than the order of noisy gray levels. Elsewhere it would only see other exposures and reflections.

    Args:
        census: of the left and the right image of each pair, uint8 (pairs, 2, H, PLANES, W + 2 MARGIN).
        y: the row.
        max_disparity: largest disparity, px.
        count: number of disparities; K is :func:`padded_count` of it.
        weak: whether gray differences are added, of a single pair.
        windows: what is searched; the costs of the rest are not defined.
        raw: uint8 (W + 2, K), written from ``raw[1]`` on; the first and last pixel are repeated for a smoothing.
        sums: scratch, uint16 (K,).
    """
    width, size = census.shape[4] - 2 * MARGIN, raw.shape[1]
    left, right = census[0, 0, y], census[0, 1, y]
    tile = y // TILE_ROWS
    for run in range(windows.run_count[tile]):
        begin, end, low, some = run_of(windows, tile, run)
        used = min(low + some, count) - low
        # Where all right pixels of the window exist: from ``inside`` to ``beyond``
        inside = min(max(max_disparity - low, begin), end)
        beyond = max(min(width - used + max_disparity - low + 1, end), inside)
        if len(census) > 1:
            inside = beyond = end
        _hamming_pixels(census, y, begin, inside, max_disparity, count, weak, raw, sums)
        # Without a view or a branch for each pixel, which took longer than the distances
        for x in range(inside, beyond):
            _hamming(left, x, right, x - max_disparity + low, weak, raw, (x + 1) * size + low, some)
            if used < some:
                raw[x + 1, count:] = LARGEST_COST
        _hamming_pixels(census, y, beyond, end, max_disparity, count, weak, raw, sums)
    for k in range(size):
        raw[0, k] = raw[1, k]
        raw[width + 1, k] = raw[width, k]


@compiled(allocates=False)
def quarter_half_quarter(before: U8, here: U8, after: U8, out: U8) -> None:
    """(before + 2 here + after) / 4 of the costs (W, K) of three rows, as two means that are rounded up."""
    for k in range(0, out.size, BYTES):
        store(out, k, mean(mean(load(before, k), load(after, k)), load(here, k)))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Census transform, and its Hamming distances as matching costs."""

from __future__ import annotations

import numba
import numpy as np

from stereo_depth_ros.core.kernels import READ_ONLY_U8, compiled
from stereo_depth_ros.core.types import U8, U16
from stereo_depth_ros.core.vectors import BYTES, add, load, mean, ones, repeat, store, xor

__all__ = [
    "CENSUS_BITS",
    "CENSUS_PLANES",
    "CENSUS_WINDOW",
    "LARGEST_COST",
    "MARGIN",
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
MARGIN = BYTES  # columns before and after the image, so that vectors may begin before it and end behind it
NEUTRAL_COST = np.uint8(CENSUS_BITS // 2)  # average cost of unrelated pixels
LARGEST_COST = np.uint8(255)  # of the disparities that only fill a vector: they never win

_ONE = np.uint8(1)
_SHARE_BITS, _HALF = np.uint32(16), np.uint32(1 << 15)  # of 1 / number of pairs, rounded


def padded_count(num_disparities: int) -> int:
    """Elements of a buffer for the costs of a pixel: whole vectors."""
    return -(-num_disparities // BYTES) * BYTES


def empty_census(*shape: int) -> U8:
    """Buffer of census codes of images of ``shape``, (..., H, W), for :func:`census_rows`."""
    *before, width = shape
    return np.zeros((*before, CENSUS_PLANES, width + 2 * MARGIN), np.uint8)


@compiled(allocates=False)
def _add_bit(neighbors: U8, centers: U8, codes: U8) -> None:
    for x in range(codes.size):
        codes[x] = np.uint8(np.uint8(codes[x] << _ONE) | np.uint8(neighbors[x] < centers[x]))


@compiled(numba.void(numba.int64, numba.int64, READ_ONLY_U8, numba.uint8[:, :, ::1]))
def census_rows(first: int, last: int, image: U8, codes: U8) -> None:
    """Census transform with a window of 7 x 5: a bit is set if the neighbor is darker than the center.

    Two opposite corners have no bit.

    Zabih and Woodfill, "Non-parametric local transforms for computing visual correspondence", ECCV 1994. The image
    is extended by its border pixels.

    Args:
        first, last: rows to write.
        image: uint8 (H, W).
        codes: uint8 (H, CENSUS_PLANES, MARGIN + W + MARGIN), eight bits of each code in a plane: many pixels in a
            vector. The margins are left as they are.
    """
    height, width = image.shape
    window = np.empty((2 * RADIUS_Y + 1, width + 2 * RADIUS_X), np.uint8)
    for y in range(first, last):
        for j in range(2 * RADIUS_Y + 1):
            row = image[min(max(y + j - RADIUS_Y, 0), height - 1)]
            window[j, :RADIUS_X] = row[0]
            window[j, RADIUS_X:-RADIUS_X] = row
            window[j, -RADIUS_X:] = row[width - 1]
        centers = window[RADIUS_Y, RADIUS_X : RADIUS_X + width]
        codes[y, :, MARGIN : MARGIN + width] = 0
        for bit in range(CENSUS_BITS):
            i, j = NEIGHBORS[bit]
            neighbors = window[RADIUS_Y + j, RADIUS_X + i : RADIUS_X + i + width]
            _add_bit(neighbors, centers, codes[y, bit // 8, MARGIN : MARGIN + width])


@compiled(allocates=False)
def _hamming(left: U8, x: int, right: U8, first: int, out: U8) -> None:
    """Distances of left pixel x to the right pixels from column ``first`` on, of the codes of a row."""
    for k in range(0, out.size, BYTES):
        at = MARGIN + first + k
        distance = ones(xor(load(right[0], at), repeat(left[0, MARGIN + x])))
        for plane in range(1, CENSUS_PLANES):
            distance = add(distance, ones(xor(load(right[plane], at), repeat(left[plane, MARGIN + x]))))
        store(out, k, distance)


@compiled(allocates=False)
def _mean_hamming(census: U8, y: int, x: int, first: int, sums: U16, out: U8) -> None:
    """Means over the pairs of the distances of left pixel (x, y) to the right pixels from column ``first`` on."""
    pairs = len(census)
    sums[:] = 0
    for n in range(pairs):
        _hamming(census[n, 0, y], x, census[n, 1, y], first, out)
        for k in range(out.size):
            sums[k] = np.uint16(sums[k] + np.uint16(out[k]))
    share = np.uint32(((1 << 16) + pairs // 2) // pairs)
    for k in range(out.size):
        out[k] = np.uint8(np.uint32(np.uint32(sums[k]) * share + _HALF) >> _SHARE_BITS)


@compiled(allocates=False)
def hamming_row(census: U8, y: int, max_disparity: int, count: int, raw: U8, sums: U16) -> None:
    """Matching costs of one row: Hamming distances, before any smoothing.

    Of several pairs of one scene the distance is the mean over the pairs, rounded to whole bits.

    Index k of a cost counts down from the largest disparity, so that it increases along the right image. Outside the
    right image the distance of the border pixel is repeated, at most ``NEUTRAL_COST``: a constant would favor the
    disparities inside, and paths would propagate that bias over images without texture. Elements from ``count`` on are
    ``LARGEST_COST``.

    Args:
        census: of the left and the right image of each pair, uint8 (pairs, 2, H, CENSUS_PLANES, W + 2 MARGIN).
        y: the row.
        max_disparity: largest disparity, px.
        count: number of disparities; K is :func:`padded_count` of it.
        raw: uint8 (W + 2, K), written from ``raw[1]`` on; the first and last pixel are repeated for a smoothing.
        sums: scratch, uint16 (K,).
    """
    width, size = census.shape[4] - 2 * MARGIN, raw.shape[1]
    for x in range(width):
        at = x - max_disparity  # right column of index 0
        begin, end = min(max(-at, 0), count), max(min(width - at, count), 0)
        here = raw[x + 1]
        if begin < end:
            first, last = begin // BYTES * BYTES, (end + BYTES - 1) // BYTES * BYTES
            if len(census) == 1:
                _hamming(census[0, 0, y], x, census[0, 1, y], at + first, here[first:last])
            else:
                _mean_hamming(census, y, x, at + first, sums[first:last], here[first:last])
            if begin > 0:
                here[:begin] = min(here[begin], NEUTRAL_COST)
            if end < size:
                here[end:count] = min(here[end - 1], NEUTRAL_COST)
                here[count:] = LARGEST_COST
        else:
            here[:count] = NEUTRAL_COST
            here[count:] = LARGEST_COST
    for k in range(size):
        raw[0, k] = raw[1, k]
        raw[width + 1, k] = raw[width, k]


@compiled(allocates=False)
def quarter_half_quarter(before: U8, here: U8, after: U8, out: U8) -> None:
    """(before + 2 here + after) / 4 of the costs (K,) of three pixels, as two means that are rounded up."""
    for k in range(0, out.size, BYTES):
        store(out, k, mean(mean(load(before, k), load(after, k)), load(here, k)))

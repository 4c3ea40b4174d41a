# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Census codes and their smoothed Hamming distances against the definition, written in plain Python and numpy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.costs.census import (
    CENSUS_BITS,
    CENSUS_PLANES,
    LARGEST_COST,
    MARGIN,
    NEUTRAL_COST,
    census_rows,
    cost_rows,
    empty_census,
    padded_count,
)

I64 = npt.NDArray[np.int64]
U64 = npt.NDArray[np.uint64]


def census_by_definition(image: U8) -> U64:
    """uint64 (H, W): from the top left to the bottom right neighbor of 9 x 7, a bit says darker than the center."""
    height, width = image.shape
    codes = np.zeros(image.shape, np.uint64)
    for y in range(height):
        for x in range(width):
            code = 0
            for dy in range(-3, 4):
                for dx in range(-4, 5):
                    if (dy, dx) != (0, 0):
                        near = image[min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)]
                        code = 2 * code + int(near < image[y, x])
            codes[y, x] = code
    return codes


def smoothed(values: I64, axis: int) -> I64:
    """(1 2 1) / 4 with the ends repeated, as two means of two, each rounded up."""
    size = values.shape[axis]
    before = np.take(values, [max(i - 1, 0) for i in range(size)], axis)
    after = np.take(values, [min(i + 1, size - 1) for i in range(size)], axis)
    return ((before + after + 1) // 2 + values + 1) // 2


def costs_by_definition(left: U64, right: U64, max_disparity: int, count: int) -> I64:
    """int64 (H, W, K), index k is disparity ``max_disparity - k``; outside the cost at the end goes on, 31 at most."""
    raw = continued(raw_by_definition(left, right, max_disparity, count), max_disparity)
    return smoothed(smoothed(raw, axis=1), axis=0)


def raw_by_definition(left: U64, right: U64, max_disparity: int, count: int) -> I64:
    """int64 (H, W, K): the Hamming distances, 31 outside the right image."""
    height, width = left.shape
    bits = [
        np.unpackbits(np.ascontiguousarray(codes).view(np.uint8).reshape(height, width, 8), axis=2)
        for codes in (left, right)
    ]
    raw = np.full((height, width, count), 31, np.int64)
    for x in range(width):
        for k in range(count):
            if 0 <= x - max_disparity + k < width:
                raw[:, x, k] = (bits[0][:, x] != bits[1][:, x - max_disparity + k]).sum(axis=1)
    return raw


def continued(raw: I64, max_disparity: int) -> I64:
    """Outside the right image the distance at its end goes on, 31 at most."""
    _, width, count = raw.shape
    for x in range(width):
        seen = [k for k in range(count) if 0 <= x - max_disparity + k < width]
        if seen:
            raw[:, x, : seen[0]] = np.minimum(raw[:, x, [seen[0]]], 31)
            raw[:, x, seen[-1] + 1 :] = np.minimum(raw[:, x, [seen[-1]]], 31)
    return raw


def planes(codes: U64) -> U8:
    """The buffer of the kernels for codes (..., H, W); noise in the margins, which are not read."""
    buffer = empty_census(*codes.shape)
    buffer[:] = np.random.default_rng(5).integers(0, 256, buffer.shape, np.uint8)
    for plane in range(CENSUS_PLANES):
        buffer[..., plane, MARGIN:-MARGIN] = codes >> np.uint64(8 * plane) & np.uint64(255)
    return buffer


def census(image: U8) -> U64:
    """uint64 (H, W): the codes of the kernel as :func:`census_by_definition` has them."""
    buffer = empty_census(*image.shape)
    census_rows(0, len(image), image, buffer)
    return codes_of(buffer)


def codes_of(buffer: U8) -> U64:
    codes = np.zeros((len(buffer), buffer.shape[2] - 2 * MARGIN), np.uint64)
    for plane in range(CENSUS_PLANES):
        bits = min(8, CENSUS_BITS - 8 * plane)
        codes = codes << np.uint64(bits) | buffer[:, plane, MARGIN:-MARGIN].astype(np.uint64)
    return codes


def costs(left: U64, right: U64, max_disparity: int, count: int, first: int = 0, last: int | None = None) -> U8:
    height, width = left.shape[-2:]
    last = height if last is None else last
    size = padded_count(count)
    raw, smooth = np.empty((width + 2, size), np.uint8), np.empty((3, width, size), np.uint8)
    sums = np.empty(size, np.uint16)
    cost = np.full((last - first, width, size), 77, np.uint8)
    census = planes(np.stack([left, right], axis=-3).reshape(-1, 2, height, width))  # of one pair, or of several
    cost_rows(census, first, last, max_disparity, count, raw, sums, smooth, cost)
    assert (cost[..., count:] == LARGEST_COST).all()
    return cost[..., :count]


@pytest.mark.parametrize("shape", [(13, 29), (1, 17), (9, 1), (2, 3)])
@pytest.mark.parametrize("levels", [256, 3])
def test_census_is_that_of_the_definition(shape: tuple[int, int], levels: int) -> None:
    image = np.random.default_rng(levels).integers(0, levels, shape, np.uint8)  # 3 levels: many neighbors are equal
    np.testing.assert_array_equal(census(image), census_by_definition(image))


def test_census_of_some_rows_leaves_the_others() -> None:
    image = np.random.default_rng(1).integers(0, 256, (12, 15), np.uint8)
    buffer = empty_census(*image.shape)
    buffer[:] = 7
    census_rows(4, 9, image, buffer)
    np.testing.assert_array_equal(codes_of(buffer[4:9]), census_by_definition(image)[4:9])
    assert (buffer[:4] == 7).all() and (buffer[9:] == 7).all() and (buffer[..., :MARGIN] == 7).all()


def test_census_ignores_gain_and_offset_and_takes_read_only_images() -> None:
    image = np.random.default_rng(2).integers(0, 100, (10, 21), np.uint8)
    frozen = np.frombuffer((2 * image + 50).tobytes(), np.uint8).reshape(image.shape)
    np.testing.assert_array_equal(census(frozen), census(image))
    assert len(np.unique(census(image))) > 100


@pytest.mark.parametrize(
    ("shape", "max_disparity", "count"),
    [
        ((7, 40), 31, 32),
        ((6, 23), 5, 16),  # -10..5: both ends of the range leave the image
        ((5, 30), -12, 16),
        ((4, 33), 40, 32),  # 9..40: the left columns see nothing
        ((5, 9), 31, 48),  # narrower than the range
        ((1, 19), 8, 16),
        ((3, 1), 7, 16),
    ],
)
def test_costs_are_those_of_the_definition(shape: tuple[int, int], max_disparity: int, count: int) -> None:
    rng = np.random.default_rng(3)
    left, right = (rng.integers(0, 1 << CENSUS_BITS, shape, np.uint64) for _ in range(2))
    expected = costs_by_definition(left, right, max_disparity, count)
    np.testing.assert_array_equal(costs(left, right, max_disparity, count), expected)
    for first, last in ((0, 1), (shape[0] // 2, shape[0]), (shape[0] - 1, shape[0])):
        band = costs(left, right, max_disparity, count, first, last)
        np.testing.assert_array_equal(band, expected[first:last])


@pytest.mark.parametrize("pairs", [2, 3, 64])
def test_costs_of_several_pairs_are_the_means_of_their_distances(pairs: int) -> None:
    rng = np.random.default_rng(4)
    left, right = (rng.integers(0, 1 << CENSUS_BITS, (pairs, 5, 40), np.uint64) for _ in range(2))
    left[-1], right[-1] = 0, (1 << CENSUS_BITS) - 1  # 62, the largest
    distances = [raw_by_definition(*pair, 20, 32) for pair in zip(left, right, strict=True)]
    mean = np.floor(np.mean(distances, axis=0) + 0.5).astype(np.int64)
    expected = smoothed(smoothed(continued(mean, 20), axis=1), axis=0)
    np.testing.assert_array_equal(costs(left, right, 20, 32), expected)


def test_costs_computed_by_hand() -> None:
    left = np.zeros((1, 3), np.uint64)
    right = np.array([[0, 0b111, 0xFF]], np.uint64)  # distances 0, 3, 8
    # (0 + 3) / 2 -> 2, with 0: 1; (0 + 8) / 2 = 4, with 3 -> 4; (3 + 8) / 2 -> 6, with 8: 7
    np.testing.assert_array_equal(costs(left, right, 0, 1)[0, :, 0], [1, 4, 7])
    np.testing.assert_array_equal(costs(left.T.copy(), right.T.copy(), 0, 1)[:, 0, 0], [1, 4, 7])


def test_costs_are_bounded_by_the_bits_and_continue_outside() -> None:
    left = np.zeros((4, 20), np.uint64)
    right = np.full((4, 20), (1 << CENSUS_BITS) - 1, np.uint64)
    cost = costs(left, right, 31, 32)
    assert CENSUS_BITS == 62 and NEUTRAL_COST == 31
    assert (cost[:, 19, 13:] == 62).all()  # disparities 0..18, and so for the pixel to the left
    assert (cost[:, :, :11] == 31).all()  # 21..31: beyond the image for every pixel
    np.testing.assert_array_equal(costs(left, left, 31, 32), np.zeros((4, 20, 32)))
    assert (costs(left, left, 60, 32) == 31).all()  # 29..60: no pixel sees any

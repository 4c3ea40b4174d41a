# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Census codes and their Hamming distances against the definition, written in plain Python and numpy."""

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
    empty_census,
    hamming_row,
    padded_count,
)

I64 = npt.NDArray[np.int64]
U64 = npt.NDArray[np.uint64]


def census_by_definition(image: U8) -> U64:
    """uint64 (H, W): from the top left to the bottom right neighbor of 7 x 5, without these two: a bit says darker."""
    height, width = image.shape
    codes = np.zeros(image.shape, np.uint64)
    for y in range(height):
        for x in range(width):
            code = 0
            for dy in range(-2, 3):
                for dx in range(-3, 4):
                    if (dy, dx) not in ((0, 0), (-2, -3), (2, 3)):
                        near = image[min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)]
                        code = 2 * code + int(near < image[y, x])
            codes[y, x] = code
    return codes


def costs_by_definition(left: U64, right: U64, max_disparity: int, count: int) -> I64:
    """int64 (H, W, K), index k is disparity ``max_disparity - k``; outside the cost at the end goes on, 16 at most."""
    return continued(raw_by_definition(left, right, max_disparity, count), max_disparity)


def raw_by_definition(left: U64, right: U64, max_disparity: int, count: int) -> I64:
    """int64 (H, W, K): the Hamming distances, 16 outside the right image."""
    height, width = left.shape
    bits = [
        np.unpackbits(np.ascontiguousarray(codes).view(np.uint8).reshape(height, width, 8), axis=2)
        for codes in (left, right)
    ]
    raw = np.full((height, width, count), 16, np.int64)
    for x in range(width):
        for k in range(count):
            if 0 <= x - max_disparity + k < width:
                raw[:, x, k] = (bits[0][:, x] != bits[1][:, x - max_disparity + k]).sum(axis=1)
    return raw


def continued(raw: I64, max_disparity: int) -> I64:
    """Outside the right image the distance at its end goes on, 16 at most."""
    _, width, count = raw.shape
    for x in range(width):
        seen = [k for k in range(count) if 0 <= x - max_disparity + k < width]
        if seen:
            raw[:, x, : seen[0]] = np.minimum(raw[:, x, [seen[0]]], 16)
            raw[:, x, seen[-1] + 1 :] = np.minimum(raw[:, x, [seen[-1]]], 16)
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


def costs(left: U64, right: U64, max_disparity: int, count: int) -> U8:
    height, width = left.shape[-2:]
    size = padded_count(count)
    raw, sums = np.full((height, width + 2, size), 77, np.uint8), np.empty(size, np.uint16)
    census = planes(np.stack([left, right], axis=-3).reshape(-1, 2, height, width))  # of one pair, or of several
    for y in range(height):
        hamming_row(census, y, max_disparity, count, raw[y], sums)
    np.testing.assert_array_equal(raw[:, [0, -1]], raw[:, [1, -2]])
    assert (raw[..., count:] == LARGEST_COST).all()
    return raw[:, 1:-1, :count]


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


@pytest.mark.parametrize("pairs", [2, 3, 64])
def test_costs_of_several_pairs_are_the_means_of_their_distances(pairs: int) -> None:
    rng = np.random.default_rng(4)
    left, right = (rng.integers(0, 1 << CENSUS_BITS, (pairs, 5, 40), np.uint64) for _ in range(2))
    left[-1], right[-1] = 0, (1 << CENSUS_BITS) - 1  # 32, the largest
    distances = [raw_by_definition(*pair, 20, 32) for pair in zip(left, right, strict=True)]
    mean = np.floor(np.mean(distances, axis=0) + 0.5).astype(np.int64)
    np.testing.assert_array_equal(costs(left, right, 20, 32), continued(mean, 20))


def test_costs_are_bounded_by_the_bits_and_continue_outside() -> None:
    left = np.zeros((4, 20), np.uint64)
    right = np.full((4, 20), (1 << CENSUS_BITS) - 1, np.uint64)
    cost = costs(left, right, 31, 32)
    assert CENSUS_BITS == 32 and NEUTRAL_COST == 16
    assert (cost[:, 19, 12:] == 32).all()  # disparities 0..19
    assert (cost[:, :, :11] == 16).all()  # 21..31: beyond the image for every pixel
    np.testing.assert_array_equal(costs(left, left, 31, 32), np.zeros((4, 20, 32)))
    assert (costs(left, left, 60, 32) == 16).all()  # 29..60: no pixel sees any

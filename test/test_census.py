# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Census codes and their Hamming distances against the definition, written in plain Python and numpy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.matching.costs.census import (
    CAP,
    CENSUS_BITS,
    CENSUS_PLANES,
    GRAY,
    LARGEST_COST,
    MARGIN,
    NEUTRAL_COST,
    census_rows,
    empty_census,
    hamming_row,
    padded_count,
)
from stereo_depth_ros.matching.costs.windows import whole_range

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


def costs_by_definition(
    left: U64, right: U64, max_disparity: int, count: int, images: tuple[U8, U8] | None = None
) -> I64:
    """int64 (H, W, K), index k is disparity ``max_disparity - k``; outside the cost at the end goes on, 16 at most.

    With images, capped differences of gray levels are added where there is hardly any texture in the left one.
    """
    raw = raw_by_definition(left, right, max_disparity, count)
    if images is not None:
        raw += differences_by_definition(*images, max_disparity, count)
    return continued(raw, max_disparity)


def caps_by_definition(image: U8) -> I64:
    """int64 (H, W): 12 where the gray levels of 7 x 5 pixels without two corners span 6 or less, 0 from 14 on."""
    padded = np.pad(image.astype(np.int64), ((2, 2), (3, 3)), mode="edge")
    height, width = image.shape
    ways = [(y, x) for y in range(5) for x in range(7) if (y, x) not in ((0, 0), (4, 6))]
    near = np.stack([padded[y : y + height, x : x + width] for y, x in ways])
    under = np.maximum(14 - (near.max(axis=0) - near.min(axis=0)), 0)
    return np.minimum(under + (under + 1) // 2, 12)


def differences_by_definition(left: U8, right: U8, max_disparity: int, count: int) -> I64:
    """int64 (H, W, K): a quarter of the capped differences, 0 outside the right image."""
    height, width = left.shape
    caps, found = caps_by_definition(left), np.zeros((height, width, count), np.int64)
    for x in range(width):
        for k in range(count):
            if 0 <= x - max_disparity + k < width:
                difference = abs(left[:, x].astype(np.int64) - right[:, x - max_disparity + k])
                found[:, x, k] = np.minimum(difference, caps[:, x]) // 4
    return found


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


def with_grays(buffer: U8, image: U8) -> None:
    """Write what the kernel has beside the codes."""
    buffer[:, GRAY, MARGIN:-MARGIN] = image
    buffer[:, CAP, MARGIN:-MARGIN] = caps_by_definition(image)


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


def costs(left: U64, right: U64, max_disparity: int, count: int, images: tuple[U8, U8] | None = None) -> U8:
    height, width = left.shape[-2:]
    size = padded_count(count)
    raw, sums = np.full((height, width + 2, size), 77, np.uint8), np.empty(size, np.uint16)
    census = planes(np.stack([left, right], axis=-3).reshape(-1, 2, height, width))  # of one pair, or of several
    for own, image in zip(census[0], images or (), strict=False):
        with_grays(own, image)
    for y in range(height):
        hamming_row(census, y, max_disparity, count, images is not None, whole_range(height, width, size), raw[y], sums)
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


@pytest.mark.parametrize("shape", [(13, 150), (1, 64), (5, 65), (9, 1)])
def test_gray_levels_and_caps_are_beside_the_codes(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(shape[1])
    image = (rng.integers(0, 200) + rng.integers(0, 20, shape) * rng.integers(0, 2, shape)).astype(np.uint8)
    image[:, : shape[1] // 2] = 77
    buffer = empty_census(*shape)
    census_rows(0, len(image), image, buffer)
    np.testing.assert_array_equal(buffer[:, GRAY, MARGIN:-MARGIN], image)
    np.testing.assert_array_equal(buffer[:, CAP, MARGIN:-MARGIN], caps_by_definition(image))
    np.testing.assert_array_equal(codes_of(buffer), census_by_definition(image))


def test_gray_differences_are_added_where_there_is_hardly_any_texture() -> None:
    rng = np.random.default_rng(8)
    images = rng.integers(90, 106, (2, 6, 75)).astype(np.uint8)
    images[:, :, 20:] //= 4
    images[1] += 9
    codes = [census_by_definition(image) for image in images]
    expected = costs_by_definition(*codes, 40, 80, (images[0], images[1]))
    assert (expected != costs_by_definition(*codes, 40, 80)).mean() > 0.2
    np.testing.assert_array_equal(costs(*codes, 40, 80, (images[0], images[1])), expected)


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

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Operations on vectors in kernels against numpy: bytes, and words with and without a sign."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.core import vectors as v
from stereo_depth_ros.core.types import U8, U16
from stereo_depth_ros.core.vectors import BYTES, WORDS

AT = 3  # not aligned


@numba.njit
def _of_any(a: Any, b: Any, out: Any, numbers: npt.NDArray[np.uint64]) -> Any:
    x, y = v.load(a, AT), v.load(b, 0)
    v.store(out[0], 0, v.minimum(x, y))
    v.store(out[1], 0, v.maximum(x, y))
    v.store(out[2], 0, v.add(x, y))
    v.store(out[3], 0, v.subtract(x, y))
    v.store(out[4], 0, v.add_saturated(x, y))
    v.store(out[5], 0, v.subtract_saturated(x, y))
    v.store(out[6], 0, v.previous_lanes(x, y))
    v.store(out[7], 0, v.next_lanes(x, y))
    v.store(out[8], 0, v.repeat(a[0]))
    v.store(out[9], AT, x)
    numbers[0], numbers[1] = v.equal(x, y), v.at_most(x, y)
    numbers[2], numbers[3] = v.first_lane(numbers[0]), v.bit_count(numbers[1])
    numbers[4] = v.last_lane(numbers[0])
    return v.least_lane(x)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16])
def test_operations(dtype: Any) -> None:
    info, lanes = np.iinfo(dtype), BYTES if dtype == np.uint8 else WORDS
    rng = np.random.default_rng(4)
    a, b = rng.integers(info.min, info.max + 1, (2, lanes + AT)).astype(dtype)
    x = a[AT:]
    b[[5, 9, lanes - 1]] = x[[5, 9, lanes - 1]]
    y = b[:lanes]
    out, numbers = np.zeros((10, lanes + AT), dtype), np.zeros(5, np.uint64)
    least = _of_any(a, b, out, numbers)
    wide_x, wide_y = x.astype(int), y.astype(int)
    expected = [
        np.minimum(x, y),
        np.maximum(x, y),
        x + y,
        x - y,
        np.clip(wide_x + wide_y, info.min, info.max),
        np.clip(wide_x - wide_y, info.min, info.max),
        [y[-1], *x[:-1]],
        [*x[1:], y[0]],
        np.full(lanes, a[0]),
    ]
    np.testing.assert_array_equal(out[:9, :lanes], expected)
    np.testing.assert_array_equal(out[9, AT:], x)
    np.testing.assert_array_equal(out[9, :AT], 0)
    assert least == x.min()
    places = np.arange(lanes, dtype=np.uint64)
    masks = [np.bitwise_or.reduce((condition.astype(np.uint64)) << places) for condition in (x == y, x <= y)]
    assert numbers.tolist() == [*masks, 5, int((x <= y).sum()), lanes - 1]


@numba.njit
def _of_bytes(a: U8, out: U8, words: U16, signed: npt.NDArray[np.int16]) -> None:
    x = v.load(a, AT)
    v.store(out, 0, v.quarter(x))
    v.store(words[0], 0, v.even_words(x))
    v.store(words[1], 0, v.odd_words(x))
    v.store(words[2], 0, v.quarter(v.load(words[3], 0)))
    v.store(signed, 0, v.signed(v.load(words[3], 0)))


def test_bytes_and_words() -> None:
    rng = np.random.default_rng(5)
    a = rng.integers(0, 256, BYTES + AT).astype(np.uint8)
    out, words, signed = np.zeros(BYTES, np.uint8), np.zeros((4, WORDS), np.uint16), np.zeros(WORDS, np.int16)
    words[3] = rng.integers(0, 2**16, WORDS)
    _of_bytes(a, out, words, signed)
    np.testing.assert_array_equal(out, a[AT:] // 4)
    np.testing.assert_array_equal(words[:3], [a[AT::2], a[AT + 1 :: 2], words[3] // 4])
    np.testing.assert_array_equal(signed, words[3].view(np.int16))


@numba.njit
def _no_lane() -> tuple[int, int]:
    return v.first_lane(np.uint64(0)), v.last_lane(np.uint64(0))


def test_no_bit_has_no_place() -> None:
    assert _no_lane() == (64, -1)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Each operation on vectors in kernels against numpy."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.core import vectors as v
from stereo_depth_ros.core.types import U8, U16
from stereo_depth_ros.core.vectors import BYTES, WORDS

U64 = npt.NDArray[np.uint64]
AT = 3  # not aligned


@numba.njit
def _of_bytes(a: U8, b: U8, out: U8, masks: U64) -> None:
    x, y = v.load(a, AT), v.load(b, 0)
    v.store(out[0], 0, v.minimum(x, y))
    v.store(out[1], 0, v.add(x, y))
    v.store(out[2], 0, v.subtract(x, y))
    v.store(out[3], 0, v.add_saturated(x, y))
    v.store(out[4], 0, v.xor(x, y))
    v.store(out[5], 0, v.mean(x, y))
    v.store(out[6], 0, v.previous_lanes(x, y))
    v.store(out[7], 0, v.next_lanes(x, y))
    v.store(out[8], 0, v.ones(x))
    v.store(out[9], 0, v.where_less(x, y, v.repeat(a[0]), x))
    v.store(out[10], 0, v.join_words(v.odd_words(x), v.even_words(x)))
    v.store(out[11], 0, v.union(x, y))
    v.store(out[12], AT, x)
    masks[0] = v.equal(x, y)
    masks[1] = v.least_lane(x)
    masks[2] = v.first_lane(masks[0])


@numba.njit
def _of_words(a: U16, b: U16, codes: U8, out: U16, masks: U64) -> None:
    x, y = v.load(a, AT), v.load(b, 0)
    v.store(out[0], 0, v.minimum(x, y))
    v.store(out[1], 0, v.add(x, y))
    v.store(out[2], 0, v.subtract(x, y))
    v.store(out[3], 0, v.add_saturated(x, y))
    v.store(out[4], 0, v.multiply_high(x, y))
    v.store(out[5], 0, v.previous_lanes(x, y))
    v.store(out[6], 0, v.next_lanes(x, y))
    v.store(out[7], 0, v.where_less(x, y, v.repeat(a[0]), x))
    v.store(out[8], 0, v.even_words(v.load(codes, 0)))
    v.store(out[9], 0, v.odd_words(v.load(codes, 0)))
    v.store(out[10], 0, v.ramp())
    v.store(out[11], 0, v.multiply(x, y))
    masks[0] = v.equal(x, y)
    masks[1] = v.least_lane(x)
    masks[2] = v.first_lane(masks[0])
    masks[3] = v.sum_of_lanes(x)


def operands(dtype: Any, count: int) -> tuple[Any, Any, Any]:
    """Asymmetric values with the extremes, and some equal lanes; the vectors begin at ``AT`` and at 0."""
    rng = np.random.default_rng(count)
    top = np.iinfo(dtype).max
    a, b = rng.integers(0, top, (2, 2 * count), dtype, endpoint=True)
    a[AT : AT + 4], b[:4] = [0, top, top, 7], [top, top, 1, 7]
    b[count - 1], a[AT + count - 1] = 5, 5
    return a, b, a[AT : AT + count]


def mask_of(lanes: npt.NDArray[np.bool_]) -> int:
    return sum(1 << int(i) for i in np.flatnonzero(lanes))


def test_operations_on_bytes() -> None:
    a, b, x = operands(np.uint8, BYTES)
    y, wide = b[:BYTES], x.astype(int) + b[:BYTES]
    out, masks = np.full((13, 2 * BYTES), 77, np.uint8), np.zeros(3, np.uint64)
    _of_bytes(a, b, out, masks)
    expected = [
        np.minimum(x, y),
        wide % 256,
        (x.astype(int) - y) % 256,
        np.minimum(wide, 255),
        x ^ y,
        (wide + 1) // 2,
        np.concatenate([y[-1:], x[:-1]]),
        np.concatenate([x[1:], y[:1]]),
        np.unpackbits(x[:, None], axis=1).sum(axis=1),
        np.where(x < y, a[0], x),
        x.reshape(-1, 2)[:, ::-1].ravel(),
        x | y,
    ]
    np.testing.assert_array_equal(out[:12, :BYTES], expected)
    np.testing.assert_array_equal(out[12], [77] * AT + [*x] + [77] * (BYTES - AT))
    assert (out[:12, BYTES:] == 77).all()
    assert masks.tolist() == [mask_of(x == y), x.min(), 1]
    assert mask_of(x == y) >> 63 == 1


def test_operations_on_words() -> None:
    a, b, x = operands(np.uint16, WORDS)
    y, wide = b[:WORDS], x.astype(int) + b[:WORDS]
    codes = np.random.default_rng(9).integers(0, 256, BYTES).astype(np.uint8)
    out, masks = np.full((12, WORDS + 1), 77, np.uint16), np.zeros(4, np.uint64)
    _of_words(a, b, codes, out, masks)
    expected = [
        np.minimum(x, y),
        wide % 65536,
        (x.astype(int) - y) % 65536,
        np.minimum(wide, 65535),
        x.astype(np.int64) * y >> 16,
        np.concatenate([y[-1:], x[:-1]]),
        np.concatenate([x[1:], y[:1]]),
        np.where(x < y, a[0], x),
        codes[::2],
        codes[1::2],
        np.arange(0, 64, 2),
        x.astype(np.int64) * y % 65536,
    ]
    np.testing.assert_array_equal(out[:, :WORDS], expected)
    assert (out[:, WORDS:] == 77).all()
    assert masks.tolist() == [mask_of(x == y), x.min(), 1, x.sum()]


def test_without_a_set_bit_there_is_no_first_lane() -> None:
    first = numba.njit(lambda bits: v.first_lane(bits))
    assert [first(np.uint64(bits)) for bits in (0, 1, 1 << 63, 0b11000)] == [64, 0, 63, 3]


def test_vectors_of_different_types_do_not_mix() -> None:
    @numba.njit
    def mixed(a: U8, b: U16) -> Any:
        return v.least_lane(v.add(v.load(a, 0), v.load(b, 0)))

    with pytest.raises(numba.TypingError):
        mixed(np.zeros(BYTES, np.uint8), np.zeros(WORDS, np.uint16))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damage of the kinds that disks, networks and attackers do to a file: flipped, cut, inserted, moved, huge lengths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["mutated"]

_Damage = Callable[[bytearray, np.random.Generator], None]
# values at which lengths, counts and times go wrong: none, negative, the largest of each width, a little too large
_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1)


def mutated(data: bytes, random: np.random.Generator) -> bytes:
    """``data`` with one to three damages at random places; the same random state gives the same damages.

    Most damages change a few bytes, so that what reads the file goes on for as long as possible.
    """
    changed = bytearray(data)
    for _ in range(1 + int(random.integers(0, 3) * random.integers(0, 2))):
        _DAMAGES[int(random.integers(len(_DAMAGES)))](changed, random)
    return bytes(changed)


def _flip_bit(data: bytearray, random: np.random.Generator) -> None:
    if data:
        data[_place(data, random)] ^= 1 << int(random.integers(8))


def _set_byte(data: bytearray, random: np.random.Generator) -> None:
    if data:
        data[_place(data, random)] = int(random.choice((0, 1, 0x7F, 0x80, 0xFF, int(random.integers(256)))))


def _set_number(data: bytearray, random: np.random.Generator) -> None:
    """A number of 1, 2, 4 or 8 bytes becomes an extreme one, as in a length."""
    width = int(random.choice((1, 2, 4, 8)))
    number = _NUMBERS[int(random.integers(len(_NUMBERS)))] % 256**width
    start = _place(data, random)
    data[start : start + width] = number.to_bytes(width, "big" if random.integers(4) == 0 else "little")


def _add_to_number(data: bytearray, random: np.random.Generator) -> None:
    """A number of 1, 2, 4 or 8 bytes changes by a little."""
    width = int(random.choice((1, 2, 4, 8)))
    start = _place(data, random)
    number = int.from_bytes(data[start : start + width], "little") + int(random.integers(-4, 5))
    data[start : start + width] = (number % 256**width).to_bytes(width, "little")


def _cut_end(data: bytearray, random: np.random.Generator) -> None:
    del data[_place(data, random) :]


def _cut_out(data: bytearray, random: np.random.Generator) -> None:
    start, end = _span(data, random)
    del data[start:end]


def _insert(data: bytearray, random: np.random.Generator) -> None:
    start = _place(data, random)
    data[start:start] = random.bytes(int(random.integers(1, 17)))


def _repeat(data: bytearray, random: np.random.Generator) -> None:
    """A part of the file comes once more, elsewhere."""
    start, end = _span(data, random)
    target = _place(data, random)
    data[target:target] = data[start:end]


def _zero(data: bytearray, random: np.random.Generator) -> None:
    start, end = _span(data, random)
    data[start:end] = bytes(end - start)


def _overwrite(data: bytearray, random: np.random.Generator) -> None:
    start, end = _span(data, random)
    data[start:end] = random.bytes(end - start)


def _place(data: bytearray, random: np.random.Generator) -> int:
    """An offset in the data, 0 in empty ones; every third one is near an end, where headers and indices are."""
    last = max(len(data) - 1, 0)
    near = int(random.integers(min(last, 127) + 1))
    return (near, last - near, *(int(random.integers(last + 1)) for _ in range(4)))[int(random.integers(6))]


def _span(data: bytearray, random: np.random.Generator) -> tuple[int, int]:
    start = _place(data, random)
    return start, min(len(data), start + int(2 ** random.uniform(0, np.log2(len(data) + 2))))


_DAMAGES: tuple[_Damage, ...] = (
    *(_flip_bit, _flip_bit, _set_byte, _set_number, _set_number, _add_to_number),
    *(_cut_end, _cut_out, _insert, _repeat, _zero, _overwrite),
)

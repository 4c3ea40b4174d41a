# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pairs before each pair: how many, and what makes a stream begin anew."""

from __future__ import annotations

import pytest

from stereo_depth_ros.core.pair_memory import PairMemory

MS = 1_000_000


def test_the_newest_pairs_are_kept_in_order() -> None:
    memory: PairMemory[str] = PairMemory(3)
    assert [memory.add(pair, 0, "") for pair in "abcde"] == [(), ("a",), ("a", "b"), ("b", "c"), ("c", "d")]


def test_a_method_of_single_pairs_keeps_none() -> None:
    memory: PairMemory[str] = PairMemory(1, 100 * MS)
    assert [memory.add(pair, stamp, "") for stamp, pair in enumerate("abc")] == [(), (), ()]


@pytest.mark.parametrize(
    ("stamps_ms", "kinds", "expected"),
    [
        ((0, 100, 200), "sss", ["", "a", "ab"]),
        ((0, 100, 201), "sss", ["", "a", ""]),  # a gap
        ((0, 50, 150), "sss", ["", "a", "ab"]),  # 100 ms without the missing pair
        ((300, 400, 0), "sss", ["", "a", ""]),  # the bag begins again
        ((0, 0, 0), "sss", ["", "a", "ab"]),  # not set
        ((0, 100, 200), "stt", ["", "", "b"]),  # another size
    ],
)
def test_what_begins_anew(stamps_ms: tuple[int, ...], kinds: str, expected: list[str]) -> None:
    memory: PairMemory[str] = PairMemory(8, 100 * MS)
    found = [memory.add(*given) for given in zip("abc", (MS * t for t in stamps_ms), kinds, strict=True)]
    assert ["".join(pairs) for pairs in found] == expected


def test_without_a_limit_the_longest_gap_is_tolerated() -> None:
    memory: PairMemory[str] = PairMemory(2, None)
    memory.add("a", 0, "")
    assert memory.add("b", 10**15, "") == ("a",)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Items read ahead and written behind: in order, bounded, with errors where they belong, and nothing left running."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from stereo_depth_ros.core.side_threads import ReadAhead, WriteBehind

TIMEOUT_S = 20.0


def threads() -> set[str]:
    return {thread.name for thread in threading.enumerate()}


def test_items_come_in_order_and_the_error_after_those_before_it() -> None:
    def items() -> Iterator[int]:
        yield from range(7)
        raise ValueError("damaged")

    found = []
    with ReadAhead(items(), 2, "ahead") as ahead, pytest.raises(ValueError, match="damaged"):
        for item in ahead:
            found.append(item)
    assert found == [*range(7)]
    assert "ahead" not in threads()


def test_no_more_is_read_than_may_wait() -> None:
    third, begun = threading.Event(), []

    def items() -> Iterator[int]:
        for number in range(10):
            begun.append(number)
            if number == 3:
                third.set()
            yield number

    with ReadAhead(items(), 2, "ahead") as ahead:
        each = iter(ahead)
        assert next(each) == 0
        assert third.wait(TIMEOUT_S)  # one is taken, two wait, and one is under way
        assert begun == [0, 1, 2, 3]
    assert begun == [0, 1, 2, 3]  # the block has ended, so it reads no further
    assert "ahead" not in threads()


def test_all_is_written_in_order_when_the_block_ends() -> None:
    written: list[int] = []
    with WriteBehind(written.append, 2, "behind") as behind:
        for item in range(9):
            behind.put(item)
    assert written == [*range(9)]
    assert "behind" not in threads()


def test_an_error_of_writing_ends_the_block_and_nothing_is_written_after_it() -> None:
    written: list[int] = []

    def write(item: int) -> None:
        if item == 2:
            raise OSError("disk full")
        written.append(item)

    with pytest.raises(OSError, match="disk full"), WriteBehind(write, 1, "behind") as behind:
        for item in range(1000):
            behind.put(item)
    assert written == [0, 1]
    assert "behind" not in threads()


def test_the_error_of_the_last_item_is_raised_too() -> None:
    def write(item: int) -> None:
        raise OSError(f"item {item}")

    with pytest.raises(OSError, match="item 5"), WriteBehind(write, 3, "behind") as behind:
        behind.put(5)


def test_what_waits_is_dropped_where_the_block_ends_in_an_error() -> None:
    began, may_end, written = threading.Event(), threading.Event(), []

    def write(item: int) -> None:
        began.set()
        assert may_end.wait(TIMEOUT_S)
        written.append(item)

    def run() -> None:
        with WriteBehind(write, 2, "behind") as behind:
            for item in range(3):
                behind.put(item)
                assert began.wait(TIMEOUT_S)
            threading.Timer(0.0, may_end.set).start()
            raise KeyError("another step")

    with pytest.raises(KeyError, match="another step"):
        run()
    assert written == [*range(len(written))] and written  # the one under way is, those that wait need not be
    assert "behind" not in threads()

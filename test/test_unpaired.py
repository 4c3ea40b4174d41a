# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Why stamps have no partner: stamps not set, a side that is late, an offset that is measured whatever else is lost."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.unpaired import Arrival, cause_of_loss, stamp_offset_ns, unset_stamps

MS = 10**6
EXACT = PairingConfig()
NAMES = ("/l", "/r")


def in_turn(left: Iterable[int], right: Iterable[int], right_later: int = 0) -> list[Arrival]:
    """Arrivals of stamps in ms by time; the right ones arrive so many ms after their stamps."""
    arrivals = [(stamp, 0, stamp) for stamp in left] + [(stamp + right_later, 1, stamp) for stamp in right]
    end = max(time for time, side, _ in arrivals if side == 0)
    return [(side, stamp * MS) for time, side, stamp in sorted(arrivals) if not right_later or time <= end]


@pytest.mark.parametrize("lost", [range(0), range(15, 20), range(10), range(3, 18)])
def test_offset_is_measured_whatever_else_is_lost(lost: range) -> None:
    """Frames of the right camera are lost at the end, at the beginning or in between."""
    left = [1000 + 50 * number for number in range(20)]
    right = [1000 + 50 * number + 17 for number in range(20) if number not in lost]
    assert stamp_offset_ns([s * MS for s in left], [s * MS for s in right]) == 17 * MS
    assert stamp_offset_ns([s * MS for s in right], [s * MS for s in left]) == -17 * MS
    assert str(cause_of_loss(in_turn(left, right), NAMES, EXACT)) == (
        "stamps of /l and /r are 17.000 ms apart, the tolerance is 0 ms: set approximate_sync and an "
        "approximate_sync_tolerance_seconds above 0.017000"
    )


def test_a_side_that_has_stopped_has_no_offset() -> None:
    """The last stamps are three periods apart: another frame, not an offset."""
    left, right = [(1000 + 50 * n) * MS for n in range(10, 18)], [(1000 + 50 * n) * MS for n in range(8)]
    assert stamp_offset_ns(left, right) is None
    assert "apart" not in str(cause_of_loss([(1, s) for s in right] + [(0, s) for s in left], NAMES, EXACT))


@pytest.mark.parametrize("late", [5, 8, 30])
def test_a_side_later_than_the_queue_is_named_with_its_lag(late: int) -> None:
    stamps = [1000 + 50 * number for number in range(60)]
    assert str(cause_of_loss(in_turn(stamps, stamps, 50 * late + 1), NAMES, EXACT)) == (
        f"/r arrives {late} messages ({50 * late} ms) after those of /l with its stamps, and queue_size keeps 5: "
        f"set queue_size to {late + 1} or more, or find what delays it"
    )


@pytest.mark.parametrize("late", [0, 1, 4])
def test_a_side_within_the_queue_is_not_late(late: int) -> None:
    """Frames are lost for another reason."""
    left = [1000 + 50 * number for number in range(60)]
    right = [stamp for number, stamp in enumerate(left) if number % 7]
    assert str(cause_of_loss(in_turn(left, right, 50 * late + 1), NAMES, EXACT)) == (
        "of /l and /r, messages of one have no partner: publish both at one rate, and see what was lost"
    )


def test_a_side_whose_partners_are_kept_longer_is_not_late() -> None:
    """As color images for the disparities of a slow matcher."""
    right = [1000 + 50 * number for number in range(60)]
    arrivals = [(1 - side, stamp) for side, stamp in in_turn(right, right[::2], 50 * 9 + 1)]
    assert "/l arrives 9 messages" in str(cause_of_loss(arrivals, NAMES, EXACT))
    assert "messages of one have no partner" in str(cause_of_loss(arrivals, NAMES, EXACT, right_queue_size=20))


def test_one_side_alone_is_named() -> None:
    text = "only one of /l and /r arrives: start the other one, or remap"
    assert str(cause_of_loss([(0, 5), (0, 6)], NAMES, EXACT)) == text


@pytest.mark.parametrize(
    ("arrivals", "topics"),
    [
        ([(0, 0), (1, 0), (0, 0), (1, 0)], "/l and /r"),
        ([(0, 0), (1, 10), (0, 0), (1, 20)], "/l"),
        ([(0, 10), (1, 0), (0, 20), (1, 0)], "/r"),
    ],
)
def test_stamps_that_are_not_set_are_the_cause(arrivals: list[Arrival], topics: str) -> None:
    text = str(unset_stamps(arrivals, NAMES))
    assert text.startswith(f"the stamps of {topics} are 0, which means not set")
    assert str(cause_of_loss(arrivals, NAMES, EXACT)) == text


def test_a_single_stamp_0_is_the_beginning_of_simulated_time() -> None:
    assert unset_stamps([(0, 0), (1, 0), (0, 50), (1, 50)], NAMES) is None
    assert unset_stamps([(0, 0), (1, 0)], NAMES) is None

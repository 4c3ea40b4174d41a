# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera infos by stamp: late images, late camera infos, changes, camera infos without stamps, clocks set back."""

from __future__ import annotations

import pytest

from stereo_depth_ros.core.calibration_history import CalibrationHistory

MS = 10**6
S = 10**9


def history(*infos: tuple[int, str], right: tuple[tuple[int, str], ...] = ((0, "r"),)) -> CalibrationHistory[str]:
    """Of (stamp, contents) of the left camera, in the order of arrival."""
    made: CalibrationHistory[str] = CalibrationHistory()
    for side, received in enumerate((infos, right)):
        for stamp_ns, contents in received:
            made.add(side, stamp_ns, contents, contents)
    return made


def left_at(made: CalibrationHistory[str], stamp_ns: int) -> str:
    return made.at((stamp_ns, stamp_ns))[0]


@pytest.mark.parametrize(
    ("stamp_ns", "expected"),
    [(10, "A"), (15, "A"), (29, "A"), (30, "B"), (35, "B"), (40, "A"), (99, "A"), (9, "A")],
)
def test_the_info_of_the_stamp_or_the_newest_before_it_applies(stamp_ns: int, expected: str) -> None:
    """Before the first one it is the last one received."""
    made = history((10, "A"), (20, "A"), (30, "B"), (40, "A"))
    assert left_at(made, stamp_ns) == expected


def test_sides_have_their_own_stamps() -> None:
    made = history((10, "A"), (20, "B"), right=((13, "a"), (23, "b")))
    assert made.at((20, 22)) == ("B", "a")
    assert made.at((20, 23)) == ("B", "b")


def test_infos_without_stamps_apply_from_their_arrival_on() -> None:
    made = history((0, "A"))
    assert left_at(made, 5 * S) == "A"
    assert made.add(0, 0, "B", "B")
    assert left_at(made, 5 * S) == "B"


def test_a_clock_set_back_restarts_the_history() -> None:
    made = history((100 * S, "A"), (200 * S, "B"), (10 * S, "C"))
    assert left_at(made, 11 * S) == "C"
    assert left_at(made, 200 * S) == "C"


def test_a_repeated_round_changes_again_where_it_changed_before() -> None:
    made = history((100, "A"), (200, "B"))
    assert not made.add(0, 100, "A", "A")
    assert not made.add(0, 200, "B", "B")
    assert [left_at(made, stamp_ns) for stamp_ns in (100, 199, 200)] == ["A", "A", "B"]


@pytest.mark.parametrize(
    "order",
    [(0, 1, 2, 3, 4, 5), (0, 1, 2, 3, 5, 4), (0, 1, 3, 2, 5, 4), (1, 0, 3, 5, 4, 2), (1, 3, 5, 4, 2, 0)],
)
def test_infos_of_two_cameras_on_one_topic_apply_to_their_own_stamps(order: tuple[int, ...]) -> None:
    """However they overtake each other on the way."""
    infos = [(10, "A"), (15, "B"), (20, "A"), (25, "B"), (30, "A"), (35, "B")]
    made = history(*(infos[index] for index in order))
    assert [left_at(made, stamp_ns) for stamp_ns, _ in infos] == ["A", "B"] * 3


def test_an_info_may_still_come_between_those_of_another_calibration() -> None:
    made = history((10, "A"), (20, "A"), (30, "B"), (40, "B"), right=((40, "r"),))
    assert [made.lacks((stamp_ns, 40)) for stamp_ns in (10, 15, 20, 25, 30, 35, 40, 45)] == [False] * 3 + [
        True,
        False,
        False,
        False,
        True,
    ]
    assert not made.add(0, 25, "A", "A")
    made.add(0, 40, "B", "B")
    assert not made.lacks((25, 40))


def test_a_clock_set_back_by_less_than_a_second_changes_with_each_info() -> None:
    made = history((1000 * MS, "A"), (1100 * MS, "A"), (800 * MS, "B"))
    assert left_at(made, 850 * MS) == "B"
    for stamp_ns in range(900 * MS, 1500 * MS, 100 * MS):
        made.add(0, stamp_ns, "B", "B")
        assert left_at(made, stamp_ns) == "B"


def test_what_is_known_and_what_may_still_come() -> None:
    made: CalibrationHistory[str] = CalibrationHistory()
    assert (made.is_known, made.last_ns(0)) == (False, None)
    assert made.add(0, 10, "A", "A")
    assert not made.is_known
    assert made.lacks((10, 10))
    assert made.add(1, 10, "a", "a")
    assert made.is_known
    assert not made.lacks((10, 10))
    assert made.lacks((10, 11))
    assert made.lacks((11, 10))


def test_a_calibration_is_changing_for_a_second() -> None:
    made = history((10 * S, "A"), (11 * S, "A"))
    assert not made.is_changing((11 * S, 11 * S))
    made.add(0, 12 * S, "B", "B")
    assert made.is_changing((12 * S, 12 * S))
    assert made.is_changing((11 * S, 11 * S))
    assert made.is_changing((13 * S - 1, 13 * S))
    assert not made.is_changing((13 * S, 13 * S))


def test_many_changes_are_forgotten_from_the_oldest_on() -> None:
    made = history(*((stamp, str(stamp)) for stamp in range(1, 5001)))
    assert left_at(made, 4990) == "4990"
    assert len(made._sides[0]._changes) == 100

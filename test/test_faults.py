# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of a node: each is logged at once, then at times, and is present while it lasts."""

from __future__ import annotations

import pytest

from stereo_depth_ros.nodes.faults import FORGET_S, HOLD_S, MAX_FAULTS, QUIET_S, Faults

ENCODING = ("MessageError /left/image_raw: encoding 'nonsense' is unknown", "encoding 'nonsense' is unknown")
STEP = ("MessageError /left/image_raw: step 7 is below 640", "step 7 is below 640")


class Clock:
    """A clock that stands still."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def faults(clock: Clock) -> Faults:
    return Faults(clock)


def test_a_second_fault_is_logged_at_once(faults: Faults, clock: Clock) -> None:
    assert faults.report(*ENCODING) == ENCODING[1]
    clock.now += 0.1
    assert faults.report(*STEP) == STEP[1]
    assert faults.present() == [ENCODING[1], STEP[1]]


def test_one_fault_with_other_numbers_or_values_is_logged_at_times(faults: Faults, clock: Clock) -> None:
    assert faults.report("step 7 is below 640", "step 7") == "step 7"
    assert faults.report("step 8.5 is below 640", "step 8.5") == ""
    assert faults.report("step 9 is below 640", "step 9") == ""
    clock.now += QUIET_S
    assert faults.report("step 10 is below 640", "step 10") == "step 10 (2 more of this kind)"
    assert faults.report("encoding 'a'", "a") == "a"
    assert faults.report("encoding 'b'", "b") == ""
    assert faults.present() == ["step 10", "b"]


@pytest.mark.parametrize(
    "topics", [("/left/image_raw", "/right/image_raw"), ("/cam0/image", "/cam1/image"), ("/0", "/1")]
)
def test_topics_are_different_faults(faults: Faults, topics: tuple[str, str]) -> None:
    for topic in topics:
        assert faults.report(f"{topic}: 640x480 is not 320x240", topic)
    assert faults.present() == [*topics]
    assert not faults.report(f"{topics[0]}: 1280x720 is not 1e+3x2", topics[0])


@pytest.mark.parametrize("interval_s", [0.03, 1.0, 7.0, 12.0, 0.9 * FORGET_S])
def test_a_fault_that_recurs_stays_present(faults: Faults, clock: Clock, interval_s: float) -> None:
    faults.report(*STEP)
    clock.now += interval_s
    for _ in range(20):
        faults.report(*STEP)
        clock.now += interval_s * 0.99
        assert faults.present() == [STEP[1]]
        clock.now += interval_s * 0.01


def test_a_fault_ends_a_time_after_its_last_report_not_its_last_line(faults: Faults, clock: Clock) -> None:
    for _ in range(4):
        faults.report(*STEP)
        clock.now += 1.0
    clock.now += HOLD_S - 1.01
    assert faults.present() == [STEP[1]]
    clock.now += 0.02
    assert faults.present() == []


def test_faults_without_end_take_no_more_memory_and_few_lines(faults: Faults, clock: Clock) -> None:
    names = [f"{'abcdefghij'[n // 100]}{'abcdefghij'[n // 10 % 10]}{'abcdefghij'[n % 10]}" for n in range(1000)]
    lines = [line for name in names if (line := faults.report(name * 1000, name * 1000))]
    assert len(lines) == len(faults.present()) == MAX_FAULTS + 1
    assert faults.present()[-1].startswith(names[-1])
    assert max(map(len, faults.present())) < 1000
    clock.now += FORGET_S
    faults.report(*STEP)
    assert faults.present() == [STEP[1]]


def test_a_status_has_the_first_line_of_a_traceback(faults: Faults) -> None:
    assert faults.report("unexpected", "unexpected KeyError: 3\nTraceback").endswith("Traceback")
    assert faults.present() == ["unexpected KeyError: 3"]

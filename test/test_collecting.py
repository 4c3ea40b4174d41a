# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Collecting the captures of a sequence: announced ones, and those that only the images tell apart."""

from __future__ import annotations

import numpy as np
import pytest

from stereo_depth_ros.active.structured_light.collecting import AnnouncedPatterns, ChangingPatterns
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import U8

COUNT = 4


def test_announced_captures_come_in_the_order_of_the_patterns() -> None:
    collector: AnnouncedPatterns[str] = AnnouncedPatterns(COUNT, settle=1)
    assert collector.add("nothing is announced") is None
    for number in (2, 0, 3):
        collector.show(number)
        assert collector.add("old") is None
        collector.show(number)  # said again while it is shown
        assert collector.add(f"capture {number}") is None
        assert collector.add("another one") is None
    assert collector.missing == [1]
    collector.show(1)
    assert collector.add("old") is None
    assert collector.add("capture 1") == [f"capture {number}" for number in range(COUNT)]
    assert collector.missing == [0, 1, 2, 3]
    assert collector.abandoned == 0


def test_the_first_pattern_begins_again() -> None:
    collector: AnnouncedPatterns[str] = AnnouncedPatterns(COUNT, settle=0)
    for number in (0, 1, 0):
        collector.show(number)
        collector.add(f"capture {number}")
    assert collector.missing == [1, 2, 3]
    assert collector.abandoned == 1
    collector.restart()
    assert collector.missing == [0, 1, 2, 3]


def test_what_is_shown_after_the_last_pattern_belongs_to_no_other_sequence() -> None:
    collector: AnnouncedPatterns[str] = AnnouncedPatterns(2, settle=0)
    scans = []
    for scan in ("first", "second"):
        for number in range(2):
            collector.show(number)
            scans.append(collector.add(f"{scan} {number}"))
        collector.show(1)  # said again
        assert collector.add("still the last pattern") is None
        assert collector.missing == [0, 1]
    assert [scan for scan in scans if scan] == [["first 0", "first 1"], ["second 0", "second 1"]]
    stripes: AnnouncedPatterns[str] = AnnouncedPatterns(1, settle=0)
    stripes.show(0)
    assert [stripes.add(name) for name in "ab"] == [["a"], ["b"]]


def test_captures_of_two_calibrations_are_no_sequence() -> None:
    old, new = object(), object()
    announced: AnnouncedPatterns[str] = AnnouncedPatterns(3, settle=0)
    changing: ChangingPatterns[str] = ChangingPatterns(3, 0, lambda name: np.zeros((1, 1), np.uint8), lambda names: "")
    for number, calibration in enumerate((old, old, new)):
        announced.show(number)
        assert announced.add(f"{number}", calibration) is None
        assert changing.add(f"{number}", calibration) is None
    assert announced.missing == [0, 1]
    assert changing.seen == 1
    assert announced.abandoned == changing.abandoned == 1
    assert changing.add("3", new) is None
    assert changing.add("4", new) == ["2", "3", "4"]


def test_a_pattern_that_the_sequence_does_not_have_is_refused() -> None:
    collector: AnnouncedPatterns[str] = AnnouncedPatterns(COUNT, settle=0)
    for number in (-1, COUNT):
        with pytest.raises(ConfigError, match=f"pattern {number} is announced, the sequence has 0 to 3"):
            collector.show(number)
    assert collector.missing == [0, 1, 2, 3]


def images(*numbers: int, each: int, noise: float = 2.0, seed: int = 1) -> list[U8]:
    """``each`` noisy images of every pattern: stripes that move with its number."""
    random = np.random.default_rng(seed)
    x = np.indices((60, 80))[1]
    found = []
    for number in numbers:
        pattern = 60.0 + 90.0 * (((x + 3 * number) // 6) % 2)
        found += [np.clip(pattern + noise * random.standard_normal(x.shape), 0, 255) for _ in range(each)]
    return [np.round(image).astype(np.uint8) for image in found]


def shift(image: U8) -> int:
    """The pattern of an image, 0 to 3."""
    x = np.indices(image.shape)[1]
    scores = [np.sum(image * (((x + 3 * number) // 6) % 2 - 0.5)) for number in range(COUNT)]
    return int(np.argmax(scores))


def in_order(captured: list[U8]) -> str:
    numbers = [shift(image) for image in captured]
    return "" if numbers == [0, 1, 2, 3] else f"the order is {numbers}"


@pytest.mark.parametrize("noise", [0.0, 2.0, 4.0])
def test_captures_are_told_apart_by_their_changes(noise: float) -> None:
    """Before the sequence something else is shown; two patterns are the same, which does not count as a change."""
    collector = ChangingPatterns(COUNT, 1, lambda image: image, in_order)
    stream = images(3, 2, 0, 1, 2, 3, 0, each=3, noise=noise)
    results = [collector.add(image) for image in stream]
    complete = [result for result in results if result is not None]
    assert len(complete) == 1
    assert [shift(image) for image in complete[0]] == [0, 1, 2, 3]
    # the second of the three images of each pattern
    assert all(any(image is other for other in stream[1::3]) for image in complete[0])
    assert results.index(complete[0]) == 3 * 5 + 1
    assert collector.seen == 1


def test_without_a_pause_every_capture_is_a_pattern() -> None:
    collector = ChangingPatterns(COUNT, 0, lambda image: image, in_order)
    complete = [result for image in images(1, 0, 1, 2, 3, each=1) if (result := collector.add(image)) is not None]
    assert len(complete) == 1


def test_why_images_are_not_the_sequence() -> None:
    collector = ChangingPatterns(COUNT, 1, lambda image: image, in_order)
    assert not any(collector.add(image) is not None for image in images(0, 2, 1, 3, 0, 2, each=2))
    assert collector.seen == 6
    assert collector.fault == "the order is [1, 3, 0, 2]"
    collector.restart()
    assert (collector.seen, collector.fault) == (0, "")

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Captures of patterns that are missing, doubled or out of order are found by the images."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from projected_views import slanted_view

from stereo_depth_ros.active.structured_light.order import sequence_fault
from stereo_depth_ros.active.structured_light.patterns import Pattern, PatternSequence
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.synthetic.projection import Optics, SyntheticScanner

SIZE, PROJECTOR = (240, 180), (256, 192)


@functools.cache
def sequence(kind: str) -> PatternSequence:
    return PatternSequence.of_kind(kind, PROJECTOR, rows=True)


@functools.cache
def captured(kind: str, seed: int = 3) -> tuple[U8, ...]:
    scanner = SyntheticScanner(*SIZE, PROJECTOR, seed=seed)
    return tuple(scanner.capture(pattern)[0] for pattern in sequence(kind).render())


@pytest.mark.parametrize("kind", ["gray", "phase", "gray+phase"])
@pytest.mark.parametrize("seed", [3, 11])
def test_nothing_speaks_against_a_sequence_in_its_order(kind: str, seed: int) -> None:
    assert sequence_fault(sequence(kind), captured(kind, seed)) == ""


def shows(pattern: Pattern, other: Pattern) -> bool:
    """The coarsest bits mirror the code as a whole; cells of the finest ones are as narrow as 4 px of the camera."""
    coarsest = (PROJECTOR[pattern.axis == "rows"] - 1).bit_length() - 2
    mirrored = pattern.role == other.role == "gray" and pattern.bit == other.bit >= coarsest
    finest = pattern.role == other.role == "gray" and min(pattern.bit, other.bit) <= 2
    return not mirrored and not finest


@pytest.mark.parametrize("kind", ["gray", "phase", "gray+phase"])
def test_exchanged_neighbors_are_found(kind: str) -> None:
    images, patterns = captured(kind), sequence(kind).patterns
    for number in range(len(images) - 1):
        exchanged = [*images[:number], images[number + 1], images[number], *images[number + 2 :]]
        if shows(patterns[number], patterns[number + 1]):
            assert sequence_fault(sequence(kind), exchanged), (number, str(patterns[number]))


@pytest.mark.parametrize("kind", ["phase", "gray+phase"])
def test_an_image_in_place_of_another_is_found(kind: str) -> None:
    images, patterns = captured(kind), sequence(kind).patterns
    for number in range(1, len(images)):
        if shows(patterns[number - 1], patterns[number]):
            doubled = [*images[:number], images[number - 1], *images[number + 1 :]]
            assert sequence_fault(sequence(kind), doubled), (number, str(patterns[number]))


def test_the_missing_and_the_doubled_image_are_named() -> None:
    images, patterns = captured("gray+phase"), sequence("gray+phase")
    count = len(patterns)
    for number in (0, 1, 6):
        fault = sequence_fault(patterns, [*images[:number], *images[number + 1 :]])
        assert fault.startswith(f"{count - 1} images, the sequence has {count} patterns: image ")
        assert f"{number + 1} ({patterns.patterns[number]})" in fault
        assert fault.endswith("is probably missing")
    fault = sequence_fault(patterns, [*images[:5], images[4], *images[5:]])
    assert fault in [
        f"{count + 1} images, the sequence has {count} patterns: image {number} is probably one too many"
        for number in (5, 6)
    ]
    assert sequence_fault(patterns, images[:5]) == f"5 images, the sequence has {count} patterns"


def test_other_images_are_refused() -> None:
    images, patterns = captured("gray"), sequence("gray")
    black = [images[1]] * len(images)
    assert "the projector lights nothing" in sequence_fault(patterns, black)
    assert "have 2 sizes: 120x90, 240x180" in sequence_fault(patterns, [*images[:-1], cv2.resize(images[0], (120, 90))])
    assert "image 2 (black) is brighter than image 1 (white)" not in sequence_fault(patterns, images)
    assert "is brighter than image 1 (white)" in sequence_fault(patterns, [images[1], images[0], *images[2:]])


def gray(axis: str, bits: int, *, inverse: bool = True, cell_px: int = 1) -> list[Pattern]:
    inverses = (False, True) if inverse else (False,)
    return [Pattern("gray", axis, bit, each, cell_px) for bit in reversed(range(bits)) for each in inverses]


def steps(axis: str, period_px: float, sign: int) -> list[Pattern]:
    return [Pattern("phase", axis, period_px=period_px, shift_deg=sign * 120.0 * step) for step in range(3)]


REAL = {
    "zeng": (
        "structured_light/zeng_graycode_plane",
        "*-left.png",
        [Pattern("ambient"), Pattern("white"), Pattern("black"), *gray("columns", 12), *gray("rows", 12)],
    ),
    "house": (
        "active/e_graycode_two_views_joep/view1",
        "*.jpg",
        [Pattern("white"), Pattern("black"), *gray("columns", 10), *gray("rows", 10)],
    ),
    "board": (
        "active/a_procam_board_kamino_2poses/capture_0",
        "*.png",
        [
            *(each for axis in ("columns", "rows") for each in gray(axis, 8, inverse=False, cell_px=4)),
            *(Pattern("white"), Pattern("black")),
        ],
    ),
    "head": (
        "active/b_fringe_3freq_cfpe_david",
        "*.bmp",
        [each for period_px in (42, 45, 48) for each in steps("columns", period_px, -1)],
    ),
}


@pytest.mark.real_data
@pytest.mark.parametrize("name", REAL)
def test_real_captures(name: str, stereo_data: Path) -> None:
    folder, names, patterns = REAL[name]
    images = [np.asarray(cv2.imread(str(path), 0), np.uint8) for path in sorted((stereo_data / folder).glob(names))]
    own = PatternSequence((4096, 4096), tuple(patterns))
    assert sequence_fault(own, images) == ""
    exchanged = [*images[:4], images[6], images[5], images[4], *images[7:]]
    assert sequence_fault(own, exchanged)


def turned(sequence: PatternSequence, sign: float = 1.0, shift_deg: float = 0.0) -> PatternSequence:
    """The same images, described with other shifts of the sinusoids."""
    patterns = (
        replace(p, shift_deg=sign * p.shift_deg + shift_deg) if p.role == "phase" else p for p in sequence.patterns
    )
    return replace(sequence, patterns=tuple(patterns))


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
def test_a_gamma_of_the_projector_raises_no_alarm(steps: int) -> None:
    """A gamma of 3 makes the rest of a sinusoid, and with three steps the spread of its amplitude, as large as 0.6."""
    size = (200, 150)
    phase = PatternSequence.of_kind("phase", size, steps=steps)
    dark = [np.round(255.0 * (pattern / 255.0) ** 3).astype(np.uint8) for pattern in phase.render()]
    matrix = np.array([[0.6, 0.02, -1.0], [-0.01, 0.6, 0.5]])
    images = [np.asarray(cv2.warpAffine(each, matrix, (120, 90), flags=cv2.INTER_AREA), np.uint8) for each in dark]
    assert sequence_fault(phase, images) == ""


def test_a_camera_on_its_side_raises_no_alarm() -> None:
    """Columns then change along the columns of the image; along its rows there are only noise and outlines."""
    optics = Optics(noise=4.0)
    scanner = SyntheticScanner(*SIZE, PROJECTOR, seed=11, optics=optics)
    patterns = PatternSequence.of_kind("gray+phase", PROJECTOR)
    images = [np.ascontiguousarray(np.rot90(scanner.capture(pattern)[0])) for pattern in patterns.render()]
    assert sequence_fault(patterns, images) == ""
    assert sequence_fault(patterns, [*images[:6], images[8], images[9], images[6], images[7], *images[10:]])


@pytest.mark.parametrize("kind", ["phase", "gray+phase"])
def test_three_steps_that_are_exchanged_or_described_wrongly(kind: str) -> None:
    """Three steps fit every sinusoid: the Gray code or the other periods tell."""
    size = (200, 150)
    steps = PatternSequence.of_kind(kind, size, steps=3, periods_px=(18.0, 21.0, 25.0)[: 3 if kind == "phase" else 1])
    images = slanted_view(120, 90, noise=1.0).images(steps)
    assert sequence_fault(steps, images) == ""
    assert "wrong sign" in (fault := sequence_fault(turned(steps, -1), images)) or "shifts of the manifest" in fault
    for number in range(len(steps) - 3, len(steps) - 1):
        exchanged = [*images[:number], images[number + 1], images[number], *images[number + 2 :]]
        assert "steps are exchanged" in sequence_fault(steps, exchanged), number
    if kind == "gray+phase":
        assert "0.33 periods off the Gray code" in sequence_fault(turned(steps, 1, 120.0), images)


def test_a_bit_that_is_shown_twice_is_named() -> None:
    size = (200, 150)
    gray = PatternSequence.of_kind("gray", size)
    images = slanted_view(120, 90, blur_px=2.0).images(gray)
    assert sequence_fault(gray, images) == ""
    for number in range(5, 11):  # the finer bits are not resolved
        doubled = [*images[:number], images[number - 1], *images[number + 1 :]]
        assert f"image {number} (" in sequence_fault(gray, doubled) or f"image {number + 1} (" in sequence_fault(
            gray, doubled
        )

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Placement of boards in images, coverage by views, new views, and errors where no view is found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest
from rendered_boards import chessboard_points

from stereo_depth_ros.calibration.board_views import BoardView, Coverage, Placement, ViewCollector, placement
from stereo_depth_ros.calibration.boards import Board, Corners
from stereo_depth_ros.calibration.view_finder import find_views, first_of
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.types import F64, U8
from stereo_depth_ros.datasets.stereo_images import ImagePair

SIZE = (640, 400)
BOARD_M = chessboard_points(5, 4, 1.0)


def lying(x: float, y: float, scale: float, shear: float = 0.0) -> Corners:
    """A board of 4 x 3 squares of ``scale`` px, its first corner at x, y."""
    image: F64 = BOARD_M[:, :2] * scale + [x, y]
    image[:, 0] += shear * scale * BOARD_M[:, 1]
    return Corners(np.arange(20), BOARD_M, image)


def test_placement() -> None:
    border = np.sqrt(4 * 3) * 50
    place = placement(lying(100, 120, 50), SIZE)
    assert place.size == pytest.approx(border / np.sqrt(640 * 400))
    assert place.x == pytest.approx((200 - border / 2) / (640 - border))
    assert place.y == pytest.approx((195 - border / 2) / (400 - border))
    assert place.skew == pytest.approx(0, abs=1e-6)


def test_skew_is_the_difference_from_a_right_angle() -> None:
    place = placement(lying(100, 120, 50, shear=np.tan(np.radians(12))), SIZE)
    assert place.skew == pytest.approx(2 * np.radians(12), rel=1e-6)


def test_coverage_states_what_is_missing() -> None:
    assert Coverage.of([]).missing == ("show the board to both cameras",)
    middle = Coverage.of([Placement(0.5, 0.5, 0.2, 0.1)])
    assert not middle.complete
    assert [text.split()[-2] for text in middle.missing[:4]] == ["left", "right", "upper", "lower"]
    assert "closer" in middle.missing[4]
    assert "tilt" in middle.missing[5]
    assert middle.x == 0
    assert middle.size == pytest.approx(0.5)


def test_coverage_is_complete() -> None:
    corners = [Placement(x, y, 0.3, 0.1) for x in (0.1, 0.9) for y in (0.05, 0.95)]
    assert Coverage.of([*corners, Placement(0.5, 0.5, 0.5, 0.6)]).complete


def test_only_the_missing_end_is_named() -> None:
    places = [Placement(0.0, y, 0.5, 0.6) for y in (0.0, 1.0)]
    assert Coverage.of(places).missing == ("move the board to the right edge",)


def test_views_have_to_be_new() -> None:
    collector = ViewCollector()

    def view(x: float) -> BoardView:
        return BoardView("a", SIZE, lying(x, 100, 50), lying(x - 20, 100, 50))

    assert collector.add(view(50))
    assert not collector.add(view(60))
    assert collector.add(view(330))
    assert len(collector.views) == 2
    assert collector.coverage.x > 0.5


@dataclass
class Shown:
    """Pairs of images whose first pixel encodes their content: the x of a board, or no board where it is 0."""

    pairs: list[tuple[int, int]]
    dense: bool = False
    warnings: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)
    sizes: tuple[tuple[int, int], tuple[int, int]] = (SIZE, SIZE)

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[ImagePair]:
        for number, values in enumerate(self.pairs):
            left, right = (np.full(size[::-1], value, np.uint8) for size, value in zip(self.sizes, values, strict=True))
            yield ImagePair(f"{number}.png", left, right)


@dataclass
class Shown5x4:
    """Detects the board that such images encode, if its size is 5x4."""

    size: tuple[int, int] = (5, 4)
    counted: str = "inner corners"

    def detect(self, gray: U8) -> Corners | None:
        return lying(float(gray[0, 0]), 100, 50) if gray[0, 0] and self.size == (5, 4) else None

    def align(self, left: Corners, right: Corners) -> Corners:
        return right


def other(size: tuple[int, int]) -> Board:
    if min(size) < 3:
        raise ConfigError("too small")
    return Shown5x4(size)


def test_views_and_pairs_without() -> None:
    progress: list[tuple[int, int]] = []
    shown = Shown([(50, 40), (200, 0), (0, 60), (0, 0), (52, 40)])
    found = find_views(shown, Shown5x4(), other, lambda done, total: progress.append((done, total)))
    assert [view.name for view in found.views] == ["0.png", "4.png"]
    assert (found.left_only, found.right_only, found.not_found, found.pairs) == (["1.png"], ["2.png"], ["3.png"], 5)
    assert progress[0] == (0, 5)


def test_of_a_recording_only_new_views_are_used() -> None:
    found = find_views(Shown([(50, 40), (52, 42), (54, 44), (250, 240)], dense=True), Shown5x4(), other)
    assert [view.name for view in found.views] == ["0.png", "3.png"]
    assert found.duplicates == 2


def test_the_detected_size_is_reported() -> None:
    shown = Shown([(50, 50)] * 3)
    with pytest.raises(CalibrationError, match=r"no board of 6x5 inner corners in 3 pairs.*one of 5x4 in 3.*give 5x4"):
        find_views(shown, Shown5x4((6, 5)), other)
    with pytest.raises(CalibrationError, match="give 5x4"):
        find_views(shown, Shown5x4((4, 5)), other)
    with pytest.raises(CalibrationError, match="check the kind of board, the light"):
        find_views(Shown([(0, 0)]), Shown5x4(), other)


def test_one_camera_does_not_see_the_board() -> None:
    with pytest.raises(CalibrationError, match=r"right camera sees the board in none of 2 pairs, the left camera in 2"):
        find_views(Shown([(50, 0), (60, 0)]), Shown5x4(), other)


def test_images_of_two_sizes() -> None:
    with pytest.raises(CalibrationError, match=r"0\.png \(right\): image size 320x200, 0\.png \(left\) is 640x400"):
        find_views(Shown([(50, 50)], sizes=(SIZE, (320, 200))), Shown5x4(), other)


def test_many_skipped_pairs_are_counted() -> None:
    assert first_of(["a", "b"]) == ["a", "b"]
    assert first_of([str(number) for number in range(40)])[-2:] == ["29", "10 more skipped"]
    with pytest.raises(CalibrationError, match=r"no pair of images can be read \(0; 1; .*; 29; 2 more skipped\)"):
        find_views(Shown([], unreadable=[str(number) for number in range(32)]), Shown5x4(), other)
    with pytest.raises(CalibrationError, match="there is no pair of images"):
        find_views(Shown([]), Shown5x4(), other)


def test_the_size_of_most_images_counts() -> None:
    class Mixed(Shown):
        def __iter__(self) -> Iterator[ImagePair]:
            small = np.full((200, 320), 60, np.uint8)
            yield ImagePair("first.png", small, small)
            yield from super().__iter__()
            yield ImagePair("odd.png", np.full(SIZE[::-1], 50, np.uint8), small)

    found = find_views(Mixed([(50, 40), (200, 0)]), Shown5x4(), other)
    assert [view.name for view in found.views] == ["0.png"]
    assert (found.left_only, found.pairs) == (["1.png"], 4)
    assert found.skipped == [
        "first.png: skipped, it is 320x200, most images are 640x400",
        "odd.png: skipped, it is 640x400 and 320x200, most images are 640x400",
    ]

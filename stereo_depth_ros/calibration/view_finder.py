# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Takes the views of a board from pairs of images; says what was wrong where there are none."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from stereo_depth_ros.calibration.board_views import BoardView, ViewCollector
from stereo_depth_ros.calibration.boards import Board
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.datasets.stereo_images import StereoImages

__all__ = ["FoundViews", "find_views"]

_KEPT = 4  # images without a board that are looked at again with boards of other sizes


@dataclass
class FoundViews:
    """The views of a board in pairs of images.

    Attributes:
        views: pairs in which both cameras see the board.
        pairs: number of pairs that were looked at.
        left_only, right_only: names of the pairs in which one camera sees it.
        nowhere: names of the pairs in which neither does.
        alike: number of pairs of a recording that were passed over because the board lay as in another one.
    """

    views: list[BoardView] = field(default_factory=list)
    pairs: int = 0
    left_only: list[str] = field(default_factory=list)
    right_only: list[str] = field(default_factory=list)
    nowhere: list[str] = field(default_factory=list)
    alike: int = 0


def find_views(
    images: StereoImages,
    board: Board,
    board_of_size: Callable[[tuple[int, int]], Board],
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> FoundViews:
    """Looks for the board in all images; in a recording a view has to be new to be taken.

    Args:
        images: the pairs.
        board: what to look for.
        board_of_size: makes the same board of another size, to tell which one it is where none is found.
        progress: called with the number of pairs done and the number to do.

    Raises:
        CalibrationError: images of different sizes, or the board is in none of them, or in one camera's only.
    """
    found, collector = FoundViews(), ViewCollector()
    without: list[U8] = []
    size: tuple[str, tuple[int, int]] | None = None
    for pair in images:
        progress(found.pairs, max(len(images), found.pairs))
        found.pairs += 1
        for gray, side in ((pair.left, "left"), (pair.right, "right")):
            size = size or (f"{pair.name} (left)", _size(gray))
            _check_same_size(size, f"{pair.name} ({side})", _size(gray))
        left = board.detect(pair.left)
        if left is not None and images.dense and not collector.is_new(left, _size(pair.left)):
            found.alike += 1
            continue
        right = board.detect(pair.right)
        if left is not None and right is not None:
            view = BoardView(pair.name, _size(pair.left), left, board.align(left, right))
            collector.add(view)
            found.views.append(view)
        elif left is not None:
            found.left_only.append(pair.name)
        elif right is not None:
            found.right_only.append(pair.name)
        else:
            found.nowhere.append(pair.name)
            without += [pair.left] if len(without) < _KEPT else []
    if not found.views:
        raise CalibrationError(_why_none(found, board, board_of_size, without))
    return found


def _size(gray: U8) -> tuple[int, int]:
    return gray.shape[1], gray.shape[0]


def _check_same_size(first: tuple[str, tuple[int, int]], name: str, size: tuple[int, int]) -> None:
    if size != first[1]:
        raise CalibrationError(
            f"{name} is {size[0]}x{size[1]}, {first[0]} is {first[1][0]}x{first[1][1]}: a calibration is for one size "
            "of images in both cameras, take all of them at the same resolution"
        )


def _why_none(
    found: FoundViews, board: Board, board_of_size: Callable[[tuple[int, int]], Board], without: list[U8]
) -> str:
    for seen, names, unseen in (("left", found.left_only, "right"), ("right", found.right_only, "left")):
        if names:
            return (
                f"the {unseen} camera sees the board in none of {found.pairs} pairs, the {seen} camera in {len(names)}"
                ": hold it where both cameras see all of it, and check that the two images are of the two cameras"
            )
    columns, rows = board.size
    text = f"no board of {columns}x{rows} {board.counted} in {found.pairs} pairs of images"
    if other := _size_that_is_there(board, board_of_size, without):
        count, size = other
        return (
            f"{text}, but one of {size[0]}x{size[1]} in {count} of the {len(without)} looked at again: "
            f"--size counts {board.counted}, columns x rows: give {size[0]}x{size[1]}"
        )
    return (
        f"{text}: --size counts {board.counted}, columns x rows; check --board, the light, and that nothing covers "
        "the board or its white margin"
    )


def _size_that_is_there(
    board: Board, board_of_size: Callable[[tuple[int, int]], Board], without: Iterable[U8]
) -> tuple[int, tuple[int, int]] | None:
    """Of sizes that are easily taken for another: exchanged, squares for corners, one off; how often, and which."""
    (columns, rows), images = board.size, list(without)
    near = [(columns + across, rows + down) for across, down in ((-1, -1), (1, 1), (-1, 0), (0, -1), (1, 0), (0, 1))]
    sizes = [(rows, columns), *near, *((rows, columns) for columns, rows in near)]
    counts = [(_times_seen(board_of_size, size, images), size) for size in sizes if size != board.size]
    count, size = max(counts, key=lambda each: (each[0], each[1][0] * each[1][1]))
    return (count, size) if count else None


def _times_seen(board_of_size: Callable[[tuple[int, int]], Board], size: tuple[int, int], images: list[U8]) -> int:
    try:
        board = board_of_size(size)
    except ConfigError:  # too small, or more tags than there are
        return 0
    return sum(board.detect(gray) is not None for gray in images)

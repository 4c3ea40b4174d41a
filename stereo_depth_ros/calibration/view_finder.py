# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of a board in pairs of images, and the likely cause where no pair shows it in both cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from stereo_depth_ros.calibration.board_views import BoardView, ViewCollector
from stereo_depth_ros.calibration.boards import Board
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.datasets.stereo_images import StereoImages

__all__ = ["FoundViews", "find_views"]

_KEPT = 4  # images without a board, examined again for boards of other sizes


@dataclass
class FoundViews:
    """The views of a board in pairs of images.

    Attributes:
        views: pairs in which both cameras see the board.
        pairs: number of pairs examined.
        left_only, right_only: names of the pairs in which only one camera sees the board.
        not_found: names of the pairs in which neither camera sees it.
        duplicates: number of pairs of a recording that were skipped because the board is placed as in another one.
    """

    views: list[BoardView] = field(default_factory=list)
    pairs: int = 0
    left_only: list[str] = field(default_factory=list)
    right_only: list[str] = field(default_factory=list)
    not_found: list[str] = field(default_factory=list)
    duplicates: int = 0


def find_views(
    images: StereoImages,
    board: Board,
    board_of_size: Callable[[tuple[int, int]], Board],
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> FoundViews:
    """Detect the board in all pairs; of a recording, only views that differ are used.

    Args:
        images: the pairs.
        board: to detect.
        board_of_size: creates the same board with another size, to report the right one if the board is not found.
        progress: called with the number of pairs done and the total.

    Raises:
        CalibrationError: images of different sizes, or no pair shows the board in both cameras.
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
            found.duplicates += 1
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
            found.not_found.append(pair.name)
            without += [pair.left] if len(without) < _KEPT else []
    if not found.views:
        raise _no_views(found, board, board_of_size, without)
    return found


def _size(gray: U8) -> tuple[int, int]:
    return gray.shape[1], gray.shape[0]


def _check_same_size(first: tuple[str, tuple[int, int]], name: str, size: tuple[int, int]) -> None:
    if size != first[1]:
        raise CalibrationError(
            f"image size {size[0]}x{size[1]}, {first[0]} is {first[1][0]}x{first[1][1]}, a calibration is for one "
            "image size",
            subject=name,
            value=size,
            limit=first[1],
            remedy="record all images at the same resolution",
        )


def _no_views(
    found: FoundViews, board: Board, board_of_size: Callable[[tuple[int, int]], Board], without: list[U8]
) -> CalibrationError:
    for seen, names, unseen in (("left", found.left_only, "right"), ("right", found.right_only, "left")):
        if names:
            return CalibrationError(
                f"the {unseen} camera sees the board in none of {found.pairs} pairs, the {seen} camera in {len(names)}",
                value=0,
                limit=1,
                remedy="hold the board where both cameras see all of it, and check that the two images are of the two "
                "cameras",
                settings=("left", "right"),
            )
    columns, rows = board.size
    text = f"no board of {columns}x{rows} {board.counted} in {found.pairs} pairs of images"
    counting = f"size counts {board.counted}, columns x rows"
    if other := _detected_size(board, board_of_size, without):
        count, size = other
        return CalibrationError(
            f"{text}, but one of {size[0]}x{size[1]} in {count} of {len(without)} images examined again",
            value=board.size,
            limit=size,
            remedy=f"{counting}: give {size[0]}x{size[1]}",
            settings=("size",),
        )
    return CalibrationError(
        text,
        value=board.size,
        remedy=f"{counting}; check the kind of board, the light, and that nothing covers the board or its white margin",
        settings=("size", "board"),
    )


def _detected_size(
    board: Board, board_of_size: Callable[[tuple[int, int]], Board], without: Iterable[U8]
) -> tuple[int, tuple[int, int]] | None:
    """Detections and size of the best of the sizes that are easily confused: swapped, squares for corners, one off."""
    (columns, rows), images = board.size, list(without)
    near = [(columns + across, rows + down) for across, down in ((-1, -1), (1, 1), (-1, 0), (0, -1), (1, 0), (0, 1))]
    sizes = [(rows, columns), *near, *((rows, columns) for columns, rows in near)]
    counts = [(_detections(board_of_size, size, images), size) for size in sizes if size != board.size]
    count, size = max(counts, key=lambda each: (each[0], each[1][0] * each[1][1]))
    return (count, size) if count else None


def _detections(board_of_size: Callable[[tuple[int, int]], Board], size: tuple[int, int], images: list[U8]) -> int:
    try:
        board = board_of_size(size)
    except ConfigError:  # too small, or more tags than the family has
        return 0
    return sum(board.detect(gray) is not None for gray in images)

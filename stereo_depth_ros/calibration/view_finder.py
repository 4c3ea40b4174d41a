# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of a board in pairs of images, and the likely cause where no pair shows it in both cameras."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np

from stereo_depth_ros.calibration.board_views import BoardView, ViewCollector
from stereo_depth_ros.calibration.boards import Board
from stereo_depth_ros.calibration.camera_calibration import MIN_VIEWS
from stereo_depth_ros.calibration.chessboard import Chessboard
from stereo_depth_ros.calibration.lens_circle import LensCircle, LitPixels
from stereo_depth_ros.core.errors import CalibrationError, ConfigError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.datasets.stereo_images import ImagePair, StereoImages

__all__ = ["FoundViews", "detected_size", "find_views", "first_of"]

_MOST = 30  # pairs that are named
_SMALL_PX = 800  # width to which these are reduced
_KEPT = 2  # first, and last, images without the board, examined again for boards of other sizes


@dataclass
class FoundViews:
    """The views of a board in pairs of images.

    Attributes:
        views: pairs in which both cameras see the board.
        pairs: number of pairs examined.
        left_only, right_only: names of the pairs in which only one camera sees the board.
        not_found: names of the pairs in which neither camera sees it.
        duplicates: number of pairs of a recording that were skipped because the board is placed as in another one.
        skipped: a sentence for each pair that was skipped because an image cannot be read or has another size.
        circles: the image circles of both lenses; None where an image has no dark corners.
    """

    views: list[BoardView] = field(default_factory=list)
    pairs: int = 0
    left_only: list[str] = field(default_factory=list)
    right_only: list[str] = field(default_factory=list)
    not_found: list[str] = field(default_factory=list)
    duplicates: int = 0
    skipped: list[str] = field(default_factory=list)
    circles: tuple[LensCircle | None, LensCircle | None] = (None, None)


def find_views(
    images: StereoImages,
    board: Board,
    board_of_size: Callable[[tuple[int, int]], Board],
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> FoundViews:
    """Detect the board in all pairs; of a recording, only views that differ are used.

    Pairs with an image that cannot be read are skipped, and those of another size than most.

    Args:
        images: the pairs.
        board: to detect.
        board_of_size: creates the same board with another size, to report the right one if the board is not found.
        progress: called with the number of pairs done and the total.

    Raises:
        CalibrationError: no pair can be read or is of one size, or too few show the board in both cameras because it
            has another size or one camera does not see it.
    """
    found, collector = FoundViews(), ViewCollector()
    without, sizes, lit = _Without(), _Sizes(), (LitPixels(), LitPixels())
    for pair in images:
        progress(found.pairs, max(len(images), found.pairs))
        found.pairs += 1
        if not sizes.add(pair):
            continue
        for pixels, gray in zip(lit, (pair.left, pair.right), strict=True):
            pixels.add(gray)
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
        if left is None or right is None:
            without.add(pair.left if left is None else pair.right)
    found.skipped = [*images.unreadable, *sizes.odd()]
    _check_any(found, sizes)
    _leave_out(found, {pair.name for pair in sizes.odd_pairs()})
    if len(found.views) < MIN_VIEWS and (other := detected_size(board, board_of_size, without.images)):
        raise _other_size(found, board, *other, len(without.images))
    if not found.views:
        raise _no_views(found, board)
    found.circles = lit[0].circle(), lit[1].circle()
    return found


class _Without:
    """The first and last images without the board."""

    def __init__(self) -> None:
        self._first: list[U8] = []
        self._last: deque[U8] = deque(maxlen=_KEPT)

    def add(self, gray: U8) -> None:
        (self._first if len(self._first) < _KEPT else self._last).append(gray)

    @property
    def images(self) -> list[U8]:
        return [*self._first, *self._last]


class _Pair(NamedTuple):
    name: str
    left: tuple[int, int]
    right: tuple[int, int]


class _Sizes:
    """The sizes of all pairs."""

    def __init__(self) -> None:
        self.pairs: list[_Pair] = []

    def add(self, pair: ImagePair) -> bool:
        """Add a pair; return whether both images have one size."""
        self.pairs.append(_Pair(pair.name, _size(pair.left), _size(pair.right)))
        return self.pairs[-1].left == self.pairs[-1].right

    @property
    def common(self) -> tuple[int, int] | None:
        """The size of most pairs; None where the two images of every pair differ."""
        counts = Counter(pair.left for pair in self.pairs if pair.left == pair.right)
        return counts.most_common(1)[0][0] if counts else None

    def odd_pairs(self) -> list[_Pair]:
        """The pairs of another size."""
        return [pair for pair in self.pairs if not pair.left == pair.right == self.common]

    def odd(self) -> Iterator[str]:
        """A sentence for each."""
        if self.common is None:
            return
        for name, left, right in self.odd_pairs():
            size = _text(left) if left == right else f"{_text(left)} and {_text(right)}"
            yield f"{name}: skipped, it is {size}, most images are {_text(self.common)}"


def first_of(sentences: Sequence[str]) -> list[str]:
    """The first sentences, and how many more there are: a damaged recording has thousands of pairs."""
    more = [f"{len(sentences) - _MOST} more skipped"] if len(sentences) > _MOST else []
    return [*sentences[:_MOST], *more]


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def _check_any(found: FoundViews, sizes: _Sizes) -> None:
    if not sizes.pairs:
        reasons = "; ".join(first_of(found.skipped))
        raise CalibrationError(
            f"no pair of images can be read ({reasons})" if reasons else "there is no pair of images",
            value=0,
            limit=1,
            remedy="copy the images again",
        )
    if sizes.common is None:
        name, left, right = sizes.pairs[0]
        raise CalibrationError(
            f"image size {_text(right)}, {name} (left) is {_text(left)}, a calibration is for one image size",
            subject=f"{name} (right)",
            value=right,
            limit=left,
            remedy="record all images at the same resolution",
        )


def _leave_out(found: FoundViews, names: Collection[str]) -> None:
    """Take pairs out of all lists."""
    found.views = [view for view in found.views if view.name not in names]
    for each in (found.left_only, found.right_only, found.not_found):
        each[:] = [name for name in each if name not in names]


def _size(gray: U8) -> tuple[int, int]:
    return gray.shape[1], gray.shape[0]


def _other_size(found: FoundViews, board: Board, count: int, size: tuple[int, int], examined: int) -> CalibrationError:
    return CalibrationError(
        f"{_none_found(found, board)}, but one of {_text(size)} in {count} of {examined} images examined again",
        value=board.size,
        limit=size,
        remedy=f"{_counting(board)}: give {_text(size)}",
        settings=("size",),
    )


def _none_found(found: FoundViews, board: Board) -> str:
    what = f"board of {_text(board.size)} {board.counted} in"
    seen = f"a {what} {len(found.views)} of" if found.views else f"no {what}"
    return f"{seen} {found.pairs} pairs of images"


def _counting(board: Board) -> str:
    return f"size counts {board.counted}, columns x rows"


def _no_views(found: FoundViews, board: Board) -> CalibrationError:
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
    return CalibrationError(
        _none_found(found, board),
        value=board.size,
        remedy=f"{_counting(board)}; check the kind of board, the light, and that nothing covers the board or its "
        "white margin",
        settings=("size", "board"),
    )


def detected_size(
    board: Board, board_of_size: Callable[[tuple[int, int]], Board], images: Sequence[U8]
) -> tuple[int, tuple[int, int]] | None:
    """Images and size of the best of the sizes that are easily confused: squares for corners, one off, swapped.

    None unless half of the images show it: of a board that is larger or partly covered, some images show a smaller one
    by chance.
    """
    columns, rows = board.size
    near = [(columns + across, rows + down) for across, down in ((-1, -1), (1, 0), (0, 1), (1, 1), (-1, 0), (0, -1))]
    sizes = near if isinstance(board, Chessboard) else [*near, *((y, x) for x, y in ((columns, rows), *near))]
    images, best = [_small(gray) for gray in images], (0, board.size)
    for size in sorted(sizes, key=math.prod, reverse=True):  # a part of a board looks like a smaller one
        if size == board.size:
            continue
        count = _detections(board_of_size, size, images, least=max(best[0], -(-len(images) // 2)))
        best = max(best, (count, size), key=lambda each: (each[0], each[1][0] * each[1][1]))
        if best[0] == len(images):
            break
    return best if best[0] else None


def _small(gray: U8) -> U8:
    """The image in a size at which boards are found quickly."""
    scale = _SMALL_PX / max(gray.shape)
    return gray if scale >= 1 else np.asarray(cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _detections(
    board_of_size: Callable[[tuple[int, int]], Board], size: tuple[int, int], images: Sequence[U8], least: int
) -> int:
    """Images that show a board of that size; 0 if fewer than ``least`` do."""
    try:
        board = board_of_size(size)
    except ConfigError:  # too small, or more tags than the family has
        return 0
    count = 0
    for left, gray in zip(range(len(images), 0, -1), images, strict=True):
        if count + left < least:  # detection takes long where there is no board
            return 0
        count += board.detect(gray) is not None
    return count if count >= least else 0

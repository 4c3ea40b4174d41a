# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration boards by name and size, as users give them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from stereo_depth_ros.calibration.boards import Board
from stereo_depth_ros.calibration.chessboard import Chessboard
from stereo_depth_ros.calibration.marker_boards import AprilGrid, CharucoBoard
from stereo_depth_ros.core.errors import ConfigError

__all__ = ["BOARDS", "create_board", "parse_board_size"]

BOARDS = ("chessboard", "charuco", "aprilgrid")


def create_board(
    kind: str,
    size: tuple[int, int],
    square_m: float,
    *,
    marker_m: float | None = None,
    dictionary: str = "DICT_4X4_50",
    spacing: float = 0.3,
) -> Board:
    """Create a board of a kind.

    Args:
        kind: "chessboard", "charuco" or "aprilgrid".
        size: columns, rows: inner corners of a chessboard, squares of a ChArUco board, tags of an aprilgrid.
        square_m: side of a square, or of a tag of an aprilgrid, meters.
        marker_m: side of a marker of a ChArUco board, meters; None is 3/4 of the square.
        dictionary: OpenCV name of the marker dictionary of a ChArUco board.
        spacing: gap between the tags of an aprilgrid, as a share of ``square_m``.

    Raises:
        ConfigError: an unknown kind, a size or a length out of range, or an OpenCV without the detector.
    """
    makers: Mapping[str, Callable[[], Board]] = {
        "chessboard": lambda: Chessboard(size, square_m),
        "charuco": lambda: CharucoBoard(size, square_m, 0.75 * square_m if marker_m is None else marker_m, dictionary),
        "aprilgrid": lambda: AprilGrid(size, square_m, spacing),
    }
    if kind not in makers:
        raise ConfigError(
            f"board {kind!r} is not one of {', '.join(BOARDS)}",
            value=kind,
            limit=BOARDS,
            remedy="use one of them",
            settings=("board",),
        )
    return makers[kind]()


def parse_board_size(text: str) -> tuple[int, int]:
    """Columns and rows of a text such as "9x6".

    Raises:
        ConfigError: a text of another form.
    """
    match = re.fullmatch(r"(\d+)[xX](\d+)", text.strip())
    if not match:
        raise ConfigError(
            f"board size {text!r} is not columns x rows", value=text, remedy="write it as 9x6", settings=("size",)
        )
    return int(match[1]), int(match[2])

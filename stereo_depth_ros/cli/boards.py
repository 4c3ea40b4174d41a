# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The options of calibration boards, of the commands that calibrate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from stereo_depth_ros.calibration.board_options import BOARDS, create_board
from stereo_depth_ros.calibration.boards import Board
from stereo_depth_ros.cli.given import refuse_ignored

__all__ = ["BoardKind", "BoardSize", "Dictionary", "Marker", "Spacing", "Square", "board_maker"]

BoardSize = Annotated[
    str, typer.Option("--size", metavar="9x6", help="Set the columns x rows of inner corners, squares or tags.")
]
Square = Annotated[
    float,
    typer.Option("--square", metavar="METERS", help="Set the side of a square, or of a tag of an aprilgrid."),
]
BoardKind = Annotated[
    str,
    typer.Option(
        "--board", metavar="NAME", help=f"Look for this board: {', '.join(BOARDS)}.", autocompletion=lambda: [*BOARDS]
    ),
]
Marker = Annotated[
    float | None,
    typer.Option(
        "--marker",
        metavar="METERS",
        help="Set the side of a marker of a ChArUco board; the default is 3/4 of a square.",
    ),
]
Dictionary = Annotated[
    str, typer.Option("--dictionary", metavar="NAME", help="Set the dictionary of the markers of a ChArUco board.")
]
Spacing = Annotated[
    float,
    typer.Option("--spacing", metavar="RATIO", help="Set the gap between the tags of an aprilgrid, relative to a tag."),
]


def board_maker(
    context: typer.Context, board: str, square: float, marker: float | None, dictionary: str, spacing: float
) -> Callable[[tuple[int, int]], Board]:
    """Creates the board that these options describe, of any size; the options are named as these arguments.

    Raises:
        ConfigError: an option that has no effect with this kind of board.
    """
    if board != "charuco":
        refuse_ignored(
            context, ("marker", "dictionary"), f"with --board {board}", "leave it out, or add --board charuco"
        )
    if board != "aprilgrid":
        refuse_ignored(context, ["spacing"], f"with --board {board}", "leave it out, or add --board aprilgrid")

    def board_of_size(counts: tuple[int, int]) -> Board:
        return create_board(board, counts, square, marker_m=marker, dictionary=dictionary, spacing=spacing)

    return board_of_size

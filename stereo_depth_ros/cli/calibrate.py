# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth calibrate`: calibrates both cameras and the rig from images of a board."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.calibration.board_options import parse_board_size
from stereo_depth_ros.calibration.calibration_files import calibration_files, save_calibration
from stereo_depth_ros.calibration.camera_calibration import MIN_VIEWS
from stereo_depth_ros.calibration.projection import MODELS, check_model
from stereo_depth_ros.calibration.stereo_calibration import calibrate as calibrate_rig
from stereo_depth_ros.calibration.view_finder import FoundViews, find_views, first_of
from stereo_depth_ros.cli.boards import BoardKind, BoardSize, Dictionary, Marker, Spacing, Square, board_maker
from stereo_depth_ros.cli.calibrate_tables import calibrate_tables, calibrate_values
from stereo_depth_ros.cli.given import refuse_files
from stereo_depth_ros.cli.options import Json, Overwrite, new_app
from stereo_depth_ros.cli.output import progress_bar, show, warn
from stereo_depth_ros.core.errors import CalibrationError, OutputError
from stereo_depth_ros.datasets.stereo_images import open_stereo_images
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.plots.coverage import coverage_plot
from stereo_depth_ros.plots.drawing import save_png

__all__ = ["app"]

app = new_app()

_LISTED = 5  # names listed in one warning


@app.command()
def calibrate(
    context: typer.Context,
    place: Annotated[
        Path, typer.Argument(metavar="BAG|DIR", help="Read this raw stereo bag, or this folder of images.")
    ],
    size: BoardSize,
    square: Square,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Write the files to this folder.")],
    board: BoardKind = "chessboard",
    model: Annotated[
        str,
        typer.Option(
            metavar="NAME", help=f"Use this distortion model: {', '.join(MODELS)}.", autocompletion=lambda: [*MODELS]
        ),
    ] = "plumb_bob",
    marker: Marker = None,
    dictionary: Dictionary = "DICT_4X4_50",
    spacing: Spacing = 0.3,
    left: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC|GLOB", help="Read the left images from this topic or these files; found by default."
        ),
    ] = None,
    right: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC|GLOB", help="Read the right images from this topic or these files; found by default."
        ),
    ] = None,
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="Read both images from one topic, or from each file of the folder.")
    ] = False,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate both cameras and the rig from image pairs of a calibration board.

    In a folder, the names of the two images of a pair differ only in the camera: left01.png and right01.png,
    left/01.png and right/01.png, cam0/01.png and cam1/01.png; with --side-by-side each file holds both. Files with
    other names are found by patterns: --left "a*.png" --right "b*.png", or --left "cam*/*.png" for both cameras. From a
    bag, views that differ from each other are selected. Both cameras must see the whole chessboard, or a part of a
    ChArUco board or an aprilgrid.

    --size counts inner corners of a chessboard, squares of a ChArUco board, or tags of an aprilgrid (family 36h11, in
    the layout of Kalibr). Use plumb_bob for common lenses, rational_polynomial for wide-angle lenses (with many views
    that reach the corners of the image) and equidistant for fisheyes.

    DIR receives left.yaml and right.yaml in the format of camera_calibration, calibration.json, calibration.txt with
    the standard deviation of each parameter, and coverage.png. Views with much larger errors than the others are
    dropped with a warning; images that cannot be read, or have another size than most, are skipped and named.

    \b
    Examples:
      stereo-depth calibrate images --size 9x6 --square 0.025 -o calibration
      stereo-depth calibrate drive.mcap --board aprilgrid --size 6x6 --square 0.088 --model equidistant -o calibration
      stereo-depth calibrate images --board charuco --size 8x11 --square 0.03 --marker 0.022 -o out --json -
    """
    board_of_size = board_maker(context, board, square, marker, dictionary, spacing)
    refuse_files("--output", output)
    counts = parse_board_size(size)
    check_model(model)
    sought = board_of_size(counts)
    if output.exists() and not output.is_dir():
        raise OutputError("is not a folder", subject=str(output), remedy="name a folder", settings=("output",))
    images, coverage = open_stereo_images(place, left, right, side_by_side=side_by_side), output / "coverage.png"
    check_outputs([*calibration_files(output), coverage], images.files, reports=[json_file], overwrite=overwrite)
    with progress_bar("looking for the board") as progress:
        found = find_views(images, sought, board_of_size, progress)
    warnings = [*images.warnings, *first_of(found.skipped), *_warnings(found)]
    try:
        result = calibrate_rig(found.views, model, found.circles)
    except CalibrationError as error:
        error.problem += _reasons(found)
        raise
    save_calibration(result, output, overwrite=overwrite)
    save_png(coverage, coverage_plot(result), overwrite=overwrite)
    show(
        calibrate_tables(result, found, output),
        calibrate_values(result, found, output),
        json_file,
        overwrite=overwrite,
    )
    warnings += [f"{view.name} dropped: {view.reason}" for view in result.dropped]
    for text in (*warnings, *result.warnings):
        warn(text)


def _warnings(found: FoundViews) -> Iterator[str]:
    for names, text in (
        (found.left_only, "only the left camera sees the board"),
        (found.right_only, "only the right camera sees the board"),
        (found.not_found, "no board"),
    ):
        if names:
            listed = ", ".join(names[:_LISTED]) + (f" and {len(names) - _LISTED} more" if len(names) > _LISTED else "")
            yield f"{text} in {len(names)} of {found.pairs} pairs: {listed}"


def _reasons(found: FoundViews) -> str:
    """Why the other pairs were not used, if there are too few views."""
    if len(found.views) >= MIN_VIEWS:
        return ""
    return f" ({'; '.join([f'{found.pairs} pairs examined', *_warnings(found), *first_of(found.skipped)])})"

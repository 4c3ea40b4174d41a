# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth calibrate`: both cameras and the rig from images of a board."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from stereo_depth_ros.calibration.board_options import BOARDS, create_board, parse_board_size
from stereo_depth_ros.calibration.boards import Board
from stereo_depth_ros.calibration.calibration_files import calibration_files, save_calibration
from stereo_depth_ros.calibration.calibration_result import StereoCalibration
from stereo_depth_ros.calibration.camera_calibration import MIN_VIEWS
from stereo_depth_ros.calibration.projection import MODELS, check_model
from stereo_depth_ros.calibration.stereo_calibration import calibrate as calibrate_rig
from stereo_depth_ros.calibration.view_finder import FoundViews, find_views
from stereo_depth_ros.cli.options import Json, Overwrite, new_app
from stereo_depth_ros.cli.output import messages, progress_bar, show
from stereo_depth_ros.core.errors import BagError, CalibrationError
from stereo_depth_ros.datasets.stereo_images import open_stereo_images
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.plots.coverage import coverage_plot
from stereo_depth_ros.plots.drawing import save_png

__all__ = ["app"]

app = new_app()

_LISTED = 5  # names in one warning


@app.command()
def calibrate(
    place: Annotated[Path, typer.Argument(metavar="BAG|DIR", help="Raw stereo bag, or folder of images.")],
    size: Annotated[str, typer.Option(metavar="9x6", help="Columns x rows: inner corners, squares or tags.")],
    square: Annotated[float, typer.Option(metavar="METERS", help="Side of a square, or of a tag of an aprilgrid.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the files.")],
    board: Annotated[str, typer.Option(metavar="NAME", help=f"{', '.join(BOARDS)}.")] = "chessboard",
    model: Annotated[str, typer.Option(metavar="NAME", help=f"Distortion: {', '.join(MODELS)}.")] = "plumb_bob",
    marker: Annotated[
        float | None, typer.Option(metavar="METERS", help="charuco: side of a marker; 3/4 of a square.")
    ] = None,
    dictionary: Annotated[
        str, typer.Option(metavar="NAME", help="charuco: dictionary of the markers.")
    ] = "DICT_4X4_50",
    spacing: Annotated[
        float, typer.Option(metavar="RATIO", help="aprilgrid: gap between tags over a tag's side.")
    ] = 0.3,
    left: Annotated[
        str | None, typer.Option(metavar="TOPIC|GLOB", help="Left image topic, or file pattern; found by itself.")
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="TOPIC|GLOB", help="Right image topic, or file pattern; found by itself.")
    ] = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate both cameras and the rig from pairs of images of a board.

    A folder has pairs whose names differ in the word that names the camera (left01.png and right01.png, left/01.png and
    right/01.png, cam0/.. and cam1/..); of a bag the views are taken that differ from each other. Both cameras have to
    see the whole chessboard, or a part of a charuco board or an aprilgrid.

    --size counts inner corners of a chessboard, squares of a charuco board, tags of an aprilgrid (tags 36h11, as Kalibr
    lays them out). plumb_bob is for common lenses, rational_polynomial for wide ones (take many views, out to the
    corners of the image), equidistant for fisheyes.

    DIR gets left.yaml and right.yaml in the format of camera_calibration, calibration.json, calibration.txt with the
    standard deviation of each parameter, and coverage.png. Views that fit far less than the others are left out and
    named.

    \b
    Examples:
      stereo-depth calibrate images --size 9x6 --square 0.025 -o calibration
      stereo-depth calibrate drive.mcap --board aprilgrid --size 6x6 --square 0.088 --model equidistant -o calibration
      stereo-depth calibrate images --board charuco --size 8x11 --square 0.03 --marker 0.022 -o out --json -
    """
    counts = parse_board_size(size)

    def board_of_size(counts: tuple[int, int]) -> Board:
        return create_board(board, counts, square, marker_m=marker, dictionary=dictionary, spacing=spacing)

    check_model(model)
    sought = board_of_size(counts)
    if output.exists() and not output.is_dir():
        raise BagError(f"cannot write into {output}: it is no folder, name another with -o")
    images, coverage = open_stereo_images(place, left, right), output / "coverage.png"
    check_outputs([*calibration_files(output), coverage], images.files, reports=[json_file], overwrite=overwrite)
    with progress_bar("looking for the board") as progress:
        found = find_views(images, sought, board_of_size, progress)
    warnings = [*images.warnings, *_warnings(found)]
    try:
        result = calibrate_rig(found.views, model)
    except CalibrationError as error:
        raise CalibrationError(f"{error}{_explained(found)}") from error
    save_calibration(result, output, overwrite=overwrite)
    save_png(coverage, coverage_plot(result), overwrite=overwrite)
    show(_tables(result, found, output), _values(result, found, output), json_file, overwrite=overwrite)
    warnings += [f"{view.name} dropped: {view.reason}" for view in result.dropped]
    for text in (*warnings, *result.warnings):
        messages.print(f"warning: {text}", markup=False)


def _warnings(found: FoundViews) -> Iterator[str]:
    for names, text in (
        (found.left_only, "the board is seen by the left camera only"),
        (found.right_only, "the board is seen by the right camera only"),
        (found.nowhere, "no board"),
    ):
        if names:
            listed = ", ".join(names[:_LISTED]) + (f" and {len(names) - _LISTED} more" if len(names) > _LISTED else "")
            yield f"{text} in {len(names)} of {found.pairs} pairs: {listed}"


def _explained(found: FoundViews) -> str:
    """Where the other pairs went, when there are too few views."""
    if len(found.views) >= MIN_VIEWS:
        return ""
    return f" ({found.pairs} pairs looked at{''.join(f'; {text}' for text in _warnings(found))})"


def _values(result: StereoCalibration, found: FoundViews, output: Path) -> dict[str, Any]:
    counts = {"left_only": len(found.left_only), "right_only": len(found.right_only), "without": len(found.nowhere)}
    return {**result.to_json(), "pairs": {"total": found.pairs, **counts}, "output": str(output)}


def _tables(result: StereoCalibration, found: FoundViews, output: Path) -> Iterator[Table]:
    yield _cameras_table(result)
    yield _views_table(result)
    facts = Table.grid(padding=(0, 2))
    facts.add_row("pairs", f"{found.pairs} looked at, {len(result.views)} used, {len(result.dropped)} dropped")
    facts.add_row("baseline", f"{1e3 * result.baseline_m:.3f} ± {1e3 * result.baseline_sigma_m:.3f} mm")
    facts.add_row("rms of both cameras", f"{result.rms_stereo_px:.3f} px")
    alone = f"left {result.left.rms_alone_px:.3f}, right {result.right.rms_alone_px:.3f} px"
    facts.add_row("rms of each camera alone", alone)
    facts.add_row("rows after rectification", f"rms {result.epipolar_rms_px:.3f} px")
    cover = result.coverage
    facts.add_row("coverage", f"x {cover.x:.0%}, y {cover.y:.0%}, size {cover.size:.0%}, skew {cover.skew:.0%}")
    for number, text in enumerate(cover.missing):
        facts.add_row("to do better" if number == 0 else "", text)
    facts.add_row("files", str(output))
    yield facts


def _cameras_table(result: StereoCalibration) -> Table:
    table = _table("", "fx px", "fy px", "cx px", "cy px", "rms px")
    for side, camera in (("left", result.left), ("right", result.right)):
        values = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
        cells = [f"{value:.2f} ± {sigma:.2f}" for value, sigma in zip(values, camera.sigmas[:4], strict=True)]
        table.add_row(side, *cells, f"{camera.rms_px:.3f}")
    return table


def _views_table(result: StereoCalibration) -> Table:
    table = _table("view", "rms left px", "rms right px", "rows px")
    for view in result.views:
        table.add_row(view.name, f"{view.rms_left:.3f}", f"{view.rms_right:.3f}", f"{view.rms_rows:.3f}")
    return table


def _table(first: str, *numbers: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(first, overflow="fold")
    for title in numbers:
        table.add_column(title, justify="right", no_wrap=True, header_style="dim")
    return table

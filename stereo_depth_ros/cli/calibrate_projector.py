# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth calibrate-projector`: calibrates a projector and its camera from a board under patterns."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from stereo_depth_ros.active.projector.calibration import PROJECTOR_MODELS, calibrate_projector
from stereo_depth_ros.active.projector.poses import FoundPoses, find_poses, pose_folders
from stereo_depth_ros.active.projector.projector_files import save_projector_calibration
from stereo_depth_ros.active.projector.result import ProjectorCalibration
from stereo_depth_ros.calibration.board_options import parse_board_size
from stereo_depth_ros.calibration.calibration_files import calibration_files
from stereo_depth_ros.calibration.view_finder import first_of
from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.cli.boards import BoardKind, BoardSize, Dictionary, Marker, Spacing, Square, board_maker
from stereo_depth_ros.cli.calibrate_tables import cameras_table, views_table
from stereo_depth_ros.cli.camera_info import parse_size
from stereo_depth_ros.cli.given import refuse_files, refuse_ignored
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.options import Json, Overwrite, new_app
from stereo_depth_ros.cli.output import progress_bar, show, warn
from stereo_depth_ros.cli.tables import TextTable, facts_table
from stereo_depth_ros.core.errors import CalibrationError, OutputError
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.plots.coverage import coverage_plot
from stereo_depth_ros.plots.drawing import save_png

__all__ = ["app"]

app = new_app()

_SIDES = ("camera", "projector")


@app.command()
def calibrate(
    context: typer.Context,
    place: Annotated[
        Path, typer.Argument(metavar="DIR", help="Read this folder, which holds a folder of images for each pose.")
    ],
    size: BoardSize,
    square: Square,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Write the files to this folder.")],
    patterns: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Read what the images show from this file; by default patterns.json in DIR."),
    ] = None,
    projector_size: Annotated[
        str | None,
        typer.Option(
            metavar="1024x768",
            help="Read the images as OpenCV's Gray code for a projector of this size, without patterns.json.",
        ),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Use the calibration of the camera in this file, of any known format."),
    ] = None,
    board: BoardKind = "chessboard",
    model: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Use this distortion model: {', '.join(PROJECTOR_MODELS)}.",
            autocompletion=lambda: [*PROJECTOR_MODELS],
        ),
    ] = "plumb_bob",
    marker: Marker = None,
    dictionary: Dictionary = "DICT_4X4_50",
    spacing: Spacing = 0.3,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate a projector and its camera from a board under patterns, in several poses.

    DIR has a folder for each pose of the board, which contains an image of every pattern, in the order of the numbers
    in their names. What they show is in the manifest patterns.json that `stereo-depth patterns` writes: in DIR for all
    poses, or in the folder of a pose. The patterns must code columns and rows. Ten poses are recommended; three are
    needed, or two where --camera gives the calibration of the camera. Camera and projector must not move between the
    poses, and the board must be still in each of them.

    Without patterns.json, --projector-size reads the Gray code of OpenCV's GrayCodePattern: it has columns, then rows,
    each bit followed by its inverse, with white and black before or after them.

    The output folder receives left.yaml, the camera, and right.yaml, the projector as a camera of the same size, which
    every command reads as a rig; calibration.json and calibration.txt with the standard deviation of each parameter,
    the projector in its own pixels; and coverage.png. Poses that do not fit are dropped with a warning.

    \b
    Examples:
      stereo-depth calibrate-projector board --size 9x7 --square 0.075 -o calibration
      stereo-depth calibrate-projector board --size 9x7 --square 0.075 --camera left.yaml -o calibration
      stereo-depth calibrate-projector board --size 9x7 --square 0.075 --projector-size 1024x768 -o out --json -
    """
    board_of_size = board_maker(context, board, square, marker, dictionary, spacing)
    if patterns is not None:
        refuse_ignored(context, ["projector_size"], "with --patterns, which states it", "leave it out")
    if camera is not None:
        refuse_ignored(context, ["model"], "with --camera, whose model is used", "leave it out")
    refuse_files("--output", output)
    sought = board_of_size(parse_board_size(size))
    if output.exists() and not output.is_dir():
        raise OutputError("is not a folder", subject=str(output), remedy="name a folder", settings=("output",))
    known = None if camera is None else read_camera(camera)
    folders = pose_folders(place, patterns, parse_size(projector_size))
    coverage = output / "coverage.png"
    inputs = [path for path in (patterns, camera) if path is not None] + [
        path for pose in folders for path in pose.images
    ]
    check_outputs([*calibration_files(output), coverage], inputs, reports=[json_file], overwrite=overwrite)
    prepare_kernels()
    with progress_bar("decoding") as progress:
        found = find_poses(folders, sought, board_of_size, progress)
    warnings = [*first_of(found.skipped), *_warnings(found)]
    try:
        result = calibrate_projector(found.views, found.projector_size, model, known)
    except CalibrationError as error:
        if warnings:
            error.problem += f" ({'; '.join([f'{found.poses} poses examined', *warnings])})"
        raise
    save_projector_calibration(result, output, overwrite=overwrite)
    save_png(coverage, coverage_plot(result.stereo, _SIDES, result.projector_size), overwrite=overwrite)
    show(_tables(result, found, output), _values(result, found, output), json_file, overwrite=overwrite)
    warnings += [f"{view.name} dropped: {view.reason}" for view in result.stereo.dropped]
    for text in (*warnings, *result.stereo.warnings):
        warn(text)


def _warnings(found: FoundPoses) -> Iterator[str]:
    if found.not_found:
        yield f"no board in {len(found.not_found)} of {found.poses} poses: {', '.join(first_of(found.not_found))}"


def _values(result: ProjectorCalibration, found: FoundPoses, output: Path) -> dict[str, Any]:
    counts = {"total": found.poses, "without": len(found.not_found), "skipped": len(found.skipped)}
    corners = {"seen": found.corners, "left_out": found.corners_left_out}
    return {**result.to_json(), "poses": counts, "corners": corners, "output": str(output)}


def _tables(result: ProjectorCalibration, found: FoundPoses, output: Path) -> Iterator[TextTable]:
    stereo = result.stereo
    yield cameras_table(stereo, _SIDES)
    yield views_table(stereo, _SIDES, "pose")
    facts = facts_table()
    counts = f"{found.poses} examined, {len(stereo.views)} used, {len(stereo.dropped)} dropped"
    facts.add_row("poses", counts + (f", {len(found.skipped)} skipped" if found.skipped else ""))
    facts.add_row("corners without decoded pixels around them", f"{found.corners_left_out} of {found.corners}")
    facts.add_row(
        "distance of camera and projector", f"{1e3 * stereo.baseline_m:.3f} ± {1e3 * stereo.baseline_sigma_m:.3f} mm"
    )
    facts.add_row("rms of both", f"{stereo.rms_stereo_px:.3f} px")
    alone = f"camera {stereo.left.rms_alone_px:.3f}, projector {stereo.right.rms_alone_px:.3f} px"
    facts.add_row("rms of each alone", alone)
    facts.add_row("row error after rectification", f"rms {stereo.epipolar_rms_px:.3f} px")
    if result.camera_known:
        facts.add_row("camera", "as given")
    if result.zero_coefficients:
        facts.add_row("distortion of the projector", f"{', '.join(result.zero_coefficients)} not determined, 0")
    cover = stereo.coverage
    facts.add_row("coverage", f"x {cover.x:.0%}, y {cover.y:.0%}, size {cover.size:.0%}, skew {cover.skew:.0%}")
    facts.add_row("files", str(output))
    yield facts

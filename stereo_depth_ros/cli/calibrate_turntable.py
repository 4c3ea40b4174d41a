# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth calibrate-turntable`: the axis of a turntable from images of markers or of a board on it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from stereo_depth_ros.active.light_stripe.motion_table import read_motion_table
from stereo_depth_ros.active.light_stripe.plane_file import read_plane
from stereo_depth_ros.active.light_stripe.table_targets import BoardTarget, MarkerTargets, TargetFinder
from stereo_depth_ros.active.light_stripe.turntable import TableView, TurntableCalibration, calibrate_turntable
from stereo_depth_ros.active.light_stripe.turntable_file import write_turntable
from stereo_depth_ros.calibration.board_options import BOARDS, create_board, parse_board_size
from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.cli.calibrate_laser import require_yaml
from stereo_depth_ros.cli.given import refuse_ignored
from stereo_depth_ros.cli.options import Json, Overwrite, new_app
from stereo_depth_ros.cli.output import progress_bar, show, warn
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import BagError, CalibrationError, ConfigError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.datasets.image_files import read_image
from stereo_depth_ros.datasets.numbered_images import numbered_images, read_plain_frame
from stereo_depth_ros.files.output import check_outputs

__all__ = ["app"]

app = new_app()

_TARGETS = ("markers", *BOARDS)


@app.command()
def calibrate_table(
    context: typer.Context,
    places: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Read the images of these folders, or these images.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.yaml", help="Write the axis to this file.")],
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Take the calibration of the camera from this file.")
    ] = None,
    laser: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Take the camera from this file of a light plane instead.")
    ] = None,
    target: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Look for this on the table: {', '.join(_TARGETS)}.",
            autocompletion=lambda: [*_TARGETS],
        ),
    ] = "markers",
    marker: Annotated[
        float | None,
        typer.Option(metavar="METERS", help="Set the side of a marker; on a ChArUco board 3/4 of a square."),
    ] = None,
    dictionary: Annotated[
        str, typer.Option(metavar="NAME", help="Set the dictionary of ArUco markers, or of a ChArUco board.")
    ] = "DICT_4X4_50",
    size: Annotated[
        str | None, typer.Option(metavar="9x6", help="Set the columns x rows of inner corners, squares or tags.")
    ] = None,
    square: Annotated[
        float | None, typer.Option(metavar="METERS", help="Set the side of a square, or of a tag of an aprilgrid.")
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(metavar="DEGREES", help="Set the angle by which the table turns from image to image."),
    ] = None,
    angles: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Read the angles of the images from this table, image and angle_deg."),
    ] = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate the axis of a turntable from images of markers or of a board on it.

    Single ArUco markers of one size are found by default: they can be anywhere on the table, but must not move on it.
    The camera must not move. Images of a folder are in the order of the numbers in their names. Where the angles are
    given, positive ones are right-handed about the axis; else they are estimated, and must increase in the order of the
    images. A chessboard must turn by less than 90 degrees between two images.

    \b
    Examples:
      stereo-depth calibrate-turntable table --camera camera.yaml --marker 0.03 --step 90 -o turntable.yaml
      stereo-depth calibrate-turntable table --laser laser.yaml --target charuco --size 8x11 --square 0.015 \\
        -o turntable.yaml
    """
    finder = _finder(context, target, marker, dictionary, size, square)
    if (camera is None) == (laser is None):
        raise ConfigError(
            "neither --camera nor --laser is given" if camera is None else "both --camera and --laser are given",
            remedy="give one of them, the camera is taken from it",
        )
    if step is not None and angles is not None:
        raise ConfigError("--step and --angles contradict each other", remedy="give one of them")
    require_yaml("--output", output)
    paths = numbered_images(places)
    inputs = [path for path in (camera, laser, angles) if path is not None]
    check_outputs([output], [*paths, *inputs], reports=[json_file], overwrite=overwrite)
    model = _camera(camera, laser, paths[0])
    given = _angles(paths, step, angles)
    views = []
    with progress_bar("looking for targets") as progress:
        for number, path in enumerate(paths):
            progress(number, len(paths))
            frame = read_plain_frame(path)
            _check_size(path, frame.pixels.shape, model)
            views.append(TableView(path.name, finder.find(to_gray(frame))))
    result = calibrate_turntable(views, model, given)
    write_turntable(output, result, overwrite=overwrite)
    seen = [view for view in views if view.targets]
    without = [view.name for view in views if not view.targets]
    show(
        _tables(result, seen, len(views), output),
        _values(result, seen, without, output),
        json_file,
        overwrite=overwrite,
    )
    if without:
        listed = ", ".join(without[:5]) + (f" and {len(without) - 5} more" if len(without) > 5 else "")
        warn(f"no target in {len(without)} of {len(views)} images: {listed}")


def _finder(
    context: typer.Context,
    target: str,
    marker: float | None,
    dictionary: str,
    size: str | None,
    square: float | None,
) -> TargetFinder:
    if target not in _TARGETS:
        raise ConfigError(
            f"target {target!r} is not one of {', '.join(_TARGETS)}", value=target, limit=_TARGETS, settings=("target",)
        )
    if target == "markers":
        refuse_ignored(context, ("size", "square"), "with --target markers", "name the board by --target")
        if marker is None:
            raise ConfigError("--marker is not given", remedy="measure the side of a marker, in meters")
        return MarkerTargets(marker, dictionary)
    if target != "charuco":
        refuse_ignored(
            context, ("marker", "dictionary"), f"with --target {target}", "leave it out, or add --target charuco"
        )
    if size is None or square is None:
        raise ConfigError("--size and --square of the board are not given", remedy="give both, such as 9x6 and 0.02")
    return BoardTarget(create_board(target, parse_board_size(size), square, marker_m=marker, dictionary=dictionary))


def _camera(camera: Path | None, laser: Path | None, image: Path) -> CameraModel:
    if laser is not None:
        return read_plane(laser)[1]
    assert camera is not None
    height, width = read_image(image).shape[:2]
    return read_camera(camera, (width, height))


def _angles(paths: list[Path], step: float | None, angles: Path | None) -> F64 | None:
    if step is not None:
        return np.asarray(np.radians(step) * np.arange(len(paths)), np.float64)
    if angles is None:
        return None
    table = read_motion_table(angles)
    missing = [path.name for path in paths if path.name not in table.by_image]
    if table.kind != "turntable" or missing:
        raise BagError(
            f"has no angle of {missing[0]}" if missing else "holds no angles",
            subject=str(angles),
            value=missing,
            remedy="write a row of image and angle_deg for each image",
            settings=("angles",),
        )
    return np.array([table.by_image[path.name][0] for path in paths])


def _check_size(path: Path, shape: tuple[int, ...], camera: CameraModel) -> None:
    if shape[:2] != (camera.height, camera.width):
        raise CalibrationError(
            f"the image is {shape[1]}x{shape[0]}, the camera is calibrated for {camera.width}x{camera.height}",
            subject=str(path),
            value=shape[:2],
            limit=(camera.height, camera.width),
            remedy="use the calibration of this camera at this size",
            settings=("camera", "laser"),
        )


def _values(result: TurntableCalibration, seen: list[TableView], without: list[str], output: Path) -> dict[str, Any]:
    return {
        "axis": result.turntable.axis.tolist(),
        "point_m": result.turntable.point_m.tolist(),
        "axis_sigma_deg": result.axis_sigma_deg,
        "point_sigma_m": result.point_sigma_m,
        "rms_px": result.rms_px,
        "angles_deg": {view.name: float(a) for view, a in zip(seen, np.degrees(result.angles_rad), strict=True)},
        "without": without,
        "output": str(output),
    }


def _tables(result: TurntableCalibration, seen: list[TableView], count: int, output: Path) -> Iterator[TextTable]:
    table = plain_table("image", "targets:r", "angle deg:r")
    for view, angle in zip(seen, np.degrees(result.angles_rad), strict=True):
        table.add_row(view.name, str(len(view.targets)), f"{angle:.3f}")
    yield table
    facts = facts_table()
    facts.add_row("images", f"{count} examined, {len(seen)} used")
    facts.add_row(
        "axis", " ".join(f"{value:+.5f}" for value in result.turntable.axis) + f" ± {result.axis_sigma_deg:.3f} deg"
    )
    point = " ".join(f"{1e3 * value:+.2f}" for value in result.turntable.point_m)
    facts.add_row("through", f"{point} mm ± {1e3 * result.point_sigma_m:.2f} mm")
    facts.add_row("rms of the points", f"{result.rms_px:.3f} px")
    facts.add_row("file", str(output))
    yield facts

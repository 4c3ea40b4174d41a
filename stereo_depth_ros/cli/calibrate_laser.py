# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth calibrate-laser`: the light plane of a laser from images of its stripe on a board."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from stereo_depth_ros.active.light_stripe.plane_calibration import PlaneCalibration, calibrate_plane
from stereo_depth_ros.active.light_stripe.plane_file import write_plane
from stereo_depth_ros.calibration.board_options import parse_board_size
from stereo_depth_ros.calibration.view_finder import first_of
from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.cli.boards import BoardKind, BoardSize, Dictionary, Marker, Spacing, Square, board_maker
from stereo_depth_ros.cli.given import given_parameters
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.options import Json, Overwrite, Params, new_app
from stereo_depth_ros.cli.output import progress_bar, show, warn
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table
from stereo_depth_ros.config import LightStripeConfig, replace_checked
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.core.types import Frame
from stereo_depth_ros.datasets.image_files import read_image
from stereo_depth_ros.datasets.numbered_images import numbered_images, read_plain_frame
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.light_plane import light_plane_plot

__all__ = ["app"]

app = new_app()

_MARGIN_SQUARES = 4.0


@app.command()
def calibrate_laser(
    context: typer.Context,
    places: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Read the images of these folders, or these images.")
    ],
    size: BoardSize,
    square: Square,
    camera: Annotated[Path, typer.Option(metavar="FILE", help="Take the calibration of the camera from this file.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT.yaml", help="Write the light plane to this file.")
    ],
    board: BoardKind = "chessboard",
    marker: Marker = None,
    dictionary: Dictionary = "DICT_4X4_50",
    spacing: Spacing = 0.3,
    margin: Annotated[
        float | None,
        typer.Option(
            min=0,
            metavar="METERS",
            help="Set the largest width of the board around its corners; the default is four squares.",
        ),
    ] = None,
    param: Params = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate the light plane of a laser from images of its stripe on a board.

    The whole board must be visible in each image, with the stripe across it, in another pose each time: near and far,
    and tilted. The stripe can be on the white margin of the board too. At least three poses are needed, ten are
    recommended; laser and camera must not move. Images in which the board or the stripe is not found are named; stripes
    that are off the plane of the others are dropped and named.

    OUT.yaml receives the plane in the optical frame of the camera, with standard deviations, residuals and the camera.
    The stripes and their distances from the plane are drawn in OUT.png. Parameters of --param are those of the stage
    light_stripe, such as stripe_direction.

    \b
    Examples:
      stereo-depth calibrate-laser boards --size 8x6 --square 0.04 --camera camera.yaml -o laser.yaml
      stereo-depth calibrate-laser boards --size 8x6 --square 0.04 --camera camera.yaml -o laser.yaml \\
        --param stripe_channel:=red_excess
    """
    board_of_size = board_maker(context, board, square, marker, dictionary, spacing)
    config = stripe_config(param)
    require_yaml("--output", output)
    sought = board_of_size(parse_board_size(size))
    paths, image = numbered_images(places), output.with_suffix(".png")
    check_outputs([output, image], [*paths, camera], reports=[json_file], overwrite=overwrite)
    height, width = read_image(paths[0]).shape[:2]
    model = read_camera(camera, (width, height))
    prepare_kernels()
    with progress_bar("looking for the board") as progress:
        frames = _frames(paths, progress)
        result = calibrate_plane(frames, sought, model, config, _MARGIN_SQUARES * square if margin is None else margin)
    write_plane(output, result.plane, model, result, overwrite=overwrite)
    save_png(image, light_plane_plot(result, model), overwrite=overwrite)
    show(
        _tables(result, model, len(paths), output), _values(result, len(paths), output), json_file, overwrite=overwrite
    )
    for text in (*first_of(result.skipped), *(f"dropped {text}" for text in result.dropped)):
        warn(text)


def _frames(paths: list[Path], progress: Callable[[int, int], None]) -> Iterator[tuple[str, Frame]]:
    for number, path in enumerate(paths):
        progress(number, len(paths))
        yield path.name, read_plain_frame(path)


def stripe_config(param: list[str] | None) -> LightStripeConfig:
    """The parameters of the stage light_stripe given by ``--param``.

    Raises:
        ConfigError: see :func:`given_parameters`.
    """
    return replace_checked(LightStripeConfig(), given_parameters(param or (), stages=("light_stripe",)))


def require_yaml(option: str, path: Path) -> None:
    """Refuse another suffix than that of YAML files.

    Raises:
        OutputError: another one.
    """
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise OutputError(
            f"{option} does not end in .yaml, which is what is written",
            subject=str(path),
            value=path.suffix,
            limit=(".yaml", ".yml"),
            remedy=f"name it {path.with_suffix('.yaml').name}",
        )


def _values(result: PlaneCalibration, images: int, output: Path) -> dict[str, Any]:
    return {
        "normal": result.plane.normal.tolist(),
        "d_m": result.plane.d_m,
        "offset_sigma_m": result.plane.offset_sigma_m,
        "tilt_sigma_deg": np.degrees(result.plane.tilt_sigma).tolist(),
        **result.residuals(),
        "channel": result.channel,
        "images": {"total": images, "used": len(result.stripes)},
        "dropped": result.dropped,
        "skipped": result.skipped,
        "output": str(output),
    }


def _tables(result: PlaneCalibration, camera: CameraModel, images: int, output: Path) -> Iterator[TextTable]:
    table = plain_table("image", "lines:r", "distance m:r", "board rms px:r", "off the plane mm:r")
    for stripe, residuals in zip(result.stripes, result.residuals_m, strict=True):
        depth, median = float(np.median(stripe.points_m[:, 2])), 1e3 * float(np.median(residuals))
        table.add_row(stripe.name, str(len(residuals)), f"{depth:.3f}", f"{stripe.pose_rms_px:.3f}", f"{median:+.3f}")
    yield table
    plane, facts = result.plane, facts_table()
    A, B, C = plane.normal
    facts.add_row("images", f"{images} examined, {len(result.stripes)} used")
    facts.add_row("camera", f"{camera.width}x{camera.height}, f {camera.K[0, 0]:.1f} / {camera.K[1, 1]:.1f} px")
    facts.add_row("stripe sought in", result.channel)
    facts.add_row("light plane", f"{A:.5f} X {B:+.5f} Y {C:+.5f} Z {plane.d_m:+.5f} m = 0")
    tilts = " and ".join(f"{np.degrees(sigma):.4f}" for sigma in plane.tilt_sigma)
    facts.add_row("standard deviations", f"{1e3 * plane.offset_sigma_m:.3f} mm, {tilts} degrees")
    facts.add_row("distance of the points", f"median {1e3 * result.median_m:.3f} mm, rms {1e3 * result.rms_m:.3f} mm")
    facts.add_row("file", str(output))
    yield facts

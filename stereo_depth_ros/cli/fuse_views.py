# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views of a range camera (RGB-D) for `stereo-depth fuse`: its options, and objects on a sheet of dots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.cli.export import add_files
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.output import EXIT_INCOMPLETE, progress_bar, show, tell, warn
from stereo_depth_ros.cli.tables import TextTable, facts_table
from stereo_depth_ros.core.camera import CameraModel, check_intrinsics
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.datasets.rgbd import RgbdDataset, rgbd_size
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.offline.range_views import SheetReport, fuse_on_sheet, read_sheet
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.fused import fused_plot
from stereo_depth_ros.surfaces.solid import Solid
from stereo_depth_ros.surfaces.writing import WrittenFile, write_mesh

__all__ = ["OBJECT_VOXEL_M", "DepthSigma", "DepthUnit", "Intrinsics", "Marks", "fuse_marked", "open_views"]

OBJECT_VOXEL_M = 0.002
_CAMERA_FILES = ("camera.yaml", "camera_info.yaml")

Marks = Annotated[
    Path | None,
    typer.Option(
        "--marks",
        metavar="IMAGE",
        help="Take the poses of color and depth images from the dots of this printed sheet, on which an object stands, "
        "and fuse the object above it to a closed surface.",
    ),
]
Intrinsics = Annotated[
    str | None,
    typer.Option(
        "--intrinsics",
        metavar="FX,FY,CX,CY",
        help="Set the camera of color and depth images without lens distortion, px.",
    ),
]
DepthUnit = Annotated[
    float | None,
    typer.Option(
        "--depth-unit",
        metavar="METERS",
        help="Set the unit of depth images; 0.001 by default, 0.0002 in the layout of the TUM benchmark.",
    ),
]
DepthSigma = Annotated[
    float,
    typer.Option(
        "--depth-sigma",
        metavar="METERS",
        help="Set the standard deviation of depth images at 1 m; it grows with the square of the depth.",
    ),
]


def open_views(
    folder: Path, camera_files: Sequence[Path], intrinsics: str | None, depth_unit_m: float | None, depth_sigma_m: float
) -> RgbdDataset:
    """The views of a folder.

    Raises:
        ConfigError: no camera, two of them, or a unit or standard deviation that is not above 0.
        BagError, CalibrationError: as of :class:`RgbdDataset`.
    """
    for name, value in (("depth_unit", depth_unit_m), ("depth_sigma", depth_sigma_m)):
        if value is not None and not 0 < value < math.inf:
            raise ConfigError(
                f"{name} = {value:g} m is not above 0",
                value=value,
                limit=0,
                remedy="set a positive number of meters",
                settings=(name,),
            )
    if intrinsics is not None and camera_files:
        raise ConfigError(
            "--intrinsics and --camera-info contradict each other", value=intrinsics, remedy="give one of them"
        )
    if len(camera_files) > 1:
        raise ConfigError(
            f"{len(camera_files)} calibration files, color and depth images have one camera",
            value=len(camera_files),
            limit=1,
            remedy="give that of the color images",
            settings=("camera_info",),
        )
    size = rgbd_size(folder)
    own = [folder / name for name in _CAMERA_FILES if (folder / name).is_file()]
    if intrinsics is not None:
        camera = _parsed(intrinsics, size)
    elif camera_files or own:
        camera = read_camera([*camera_files, *own][0], size)
    else:
        raise ConfigError(
            "the camera of the color images is not known",
            subject=str(folder),
            remedy="give its focal lengths and principal point, or its calibration file",
            settings=("intrinsics", "camera_info"),
        )
    return RgbdDataset(folder, camera, depth_unit_m)


def _parsed(intrinsics: str, size: tuple[int, int]) -> CameraModel:
    try:
        fx, fy, cx, cy = (float(word) for word in intrinsics.split(","))
    except ValueError as error:
        raise ConfigError(
            f"intrinsics {quoted(intrinsics)} are not four numbers",
            value=intrinsics,
            limit="FX,FY,CX,CY",
            remedy="write them as 615.3,615.8,320.1,238.6",
            settings=("intrinsics",),
        ) from error
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    camera = CameraModel(*size, "plumb_bob", K, np.zeros(5), np.identity(3), np.column_stack((K, np.zeros(3))))
    check_intrinsics(camera, "--intrinsics")
    return camera


def fuse_marked(
    dataset: RgbdDataset,
    marks: Path,
    voxel_m: float,
    sigma_1m: float,
    most_bytes: int,
    paths: tuple[Path, Path | None, Path | None],
    *,
    overwrite: bool,
) -> None:
    """Fuse an object on a sheet, write the files and print the result; exit code 3 where views were skipped.

    Args:
        dataset: the views.
        marks: image of the sheet.
        voxel_m, sigma_1m, most_bytes: as of :func:`fuse_on_sheet`.
        paths: the surface, the preview and the JSON file; None writes none.
        overwrite: replace files that are there.
    """
    output, preview, json_file = paths
    outputs = [output, *([preview] if preview is not None else [])]
    check_outputs(outputs, [*dataset.files, marks], reports=[json_file], overwrite=overwrite)
    sheet = read_sheet(marks)
    prepare_kernels()
    with progress_bar("fusing") as progress:
        report, solid = fuse_on_sheet(
            dataset, sheet, voxel_m, sigma_1m=sigma_1m, most_bytes=most_bytes, progress=progress
        )
    written = write_mesh(output, solid.mesh, z_up=True, overwrite=overwrite)
    if preview is not None:
        title = f"{output.name}: {report.fused} views, {len(solid.mesh.points_m)} points"
        save_png(preview, fused_plot(solid.mesh, title, z_up=True), overwrite=overwrite)
    values = report.to_json() | {
        "voxel_m": voxel_m,
        "measured_share": solid.measured_share,
        "pieces_removed": solid.pieces,
        "surfaces": [written.to_json()],
    }
    show(_tables(report, solid, voxel_m, written, preview), values, json_file, overwrite=overwrite)
    for text in report.warnings:
        warn(text)
    if report.fused < report.views:
        tell(f"error: {report.views - report.fused} views skipped: see the warnings above")
        raise typer.Exit(EXIT_INCOMPLETE)


def _tables(
    report: SheetReport, solid: Solid, voxel_m: float, written: WrittenFile, preview: Path | None
) -> Iterator[TextTable]:
    facts, poses = facts_table(), report.poses
    seen = int(np.count_nonzero(np.isfinite(poses.dots_m[:, 0])))
    facts.add_row("views fused", f"{report.fused} of {report.views}")
    facts.add_row("dots", f"{seen} of {len(poses.dots_m)}, {poses.reprojection_px:.2f} px from where they are seen")
    facts.add_row("dots from their plane", _mm(poses.flatness_m))
    facts.add_row("dots of single views", f"{_mm(poses.spread_m)} from the fused ones")
    facts.add_row("sheet", " x ".join(_mm(size) for size in poses.size_m))
    facts.add_row("depth of the sheet", f"{_mm(report.sheet_sigma_m)} standard deviation")
    facts.add_row("cut away", f"what is below {_mm(float(report.box.low[2]))} above the sheet, or beside it")
    if not math.isnan(report.apart):
        facts.add_row("views differ by", f"{report.apart:.2f} widths of the truncation band")
    low, high = solid.mesh.points_m.min(axis=0), solid.mesh.points_m.max(axis=0)
    facts.add_row("size", " x ".join(_mm(float(extent)) for extent in high - low))
    facts.add_row(
        "measured", f"{100 * solid.measured_share:.0f} % of the area; the rest is where no view looks, closed"
    )
    if solid.pieces:
        facts.add_row("other pieces removed", f"{solid.pieces}, {solid.piece_triangles} triangles")
    facts.add_row("voxels", _mm(voxel_m))
    add_files(facts, [written])
    if preview is not None:
        facts.add_row("preview", str(preview))
    yield facts


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.{0 if length_m >= 0.1 else 2}f} mm"

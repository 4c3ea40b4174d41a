# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth fuse`: fuses the depth of a bag or dataset, with poses of the camera, to one surface."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.poses import pose_topics, read_bag_poses
from stereo_depth_ros.bags.sources import bag_files, is_bag
from stereo_depth_ros.camera_files.urls import camera_info_paths
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo, camera_info_values
from stereo_depth_ros.cli.export import add_files
from stereo_depth_ros.cli.fuse_views import (
    OBJECT_VOXEL_M,
    DepthSigma,
    DepthUnit,
    Intrinsics,
    Marks,
    fuse_marked,
    open_views,
)
from stereo_depth_ros.cli.given import given_parameters, refuse_ignored, require_png
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.options import (
    Duration,
    Json,
    Left,
    Matcher,
    Overwrite,
    Params,
    ParamsFile,
    Right,
    SideBySide,
    Start,
    new_app,
)
from stereo_depth_ros.cli.output import EXIT_INCOMPLETE, parameter_files, progress_bar, show, tell, warn
from stereo_depth_ros.cli.params_file import read_parameters
from stereo_depth_ros.cli.tables import TextTable, facts_table
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import ConfigError, TopicError
from stereo_depth_ros.datasets.posed import open_posed
from stereo_depth_ros.datasets.rgbd import is_rgbd
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.messages.motion import TREE_TYPE
from stereo_depth_ros.offline.camera_poses import CameraPoses, poses_of_file, poses_of_topic
from stereo_depth_ros.offline.fuse import FuseReport, fuse_sequence, no_surface_error
from stereo_depth_ros.offline.provenance import provenance
from stereo_depth_ros.offline.range_views import DEPTH_SIGMA_M, RangeSequence
from stereo_depth_ros.offline.refinement import PoseRefinement
from stereo_depth_ros.offline.sequence import BagSequence, DatasetSequence, Sequence
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.fused import fused_plot
from stereo_depth_ros.surfaces.volume import FusedSurface, SurfaceVolume
from stereo_depth_ros.surfaces.writing import MESH_ENDS, WrittenFile, check_ending, write_mesh

__all__ = ["app"]

app = new_app()

_STAGES = ("pairing", "camera_info", "matching", "rectification")
_VOXEL_M = 0.02
_OF_VIEWS = ("marks", "intrinsics", "depth_unit", "depth_sigma")
_OF_PAIRS = ("pose_frame", "matcher", "param", "params_file", "side_by_side")
_OF_POSES = ("poses", "refine", "max_gap", "max_depth", "every", "min_piece", "fill")
_OF_BAGS = ("start", "duration", "left", "right", "world_frame")


@app.command(cls=CommandWithCameraInfo)
def fuse(
    context: typer.Context,
    place: Annotated[
        Path,
        typer.Argument(
            metavar="BAG|DIR",
            help="Read this bag, a sequence of KITTI or EuRoC, a folder of images and calibration, or one of color and "
            "depth images (plainly numbered, or of the TUM benchmark).",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write a mesh (.ply, .glb) or a cloud (.cloud.ply, .pcd, .las, .laz, .xyz).",
        ),
    ],
    poses: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|TOPIC",
            help="Read the poses from this file (KITTI, EuRoC or TUM) or topic (odometry, poses, transforms); by "
            "default from the file of the sequence, or from the only such topic.",
        ),
    ] = None,
    pose_frame: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Take the poses as those of camera (the left one), rectified, body, or a frame of the bag.",
        ),
    ] = None,
    world_frame: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Fuse in this frame of a topic of transforms; their root by default."),
    ] = None,
    marks: Marks = None,
    intrinsics: Intrinsics = None,
    depth_unit: DepthUnit = None,
    depth_sigma: DepthSigma = DEPTH_SIGMA_M,
    max_gap: Annotated[
        float,
        typer.Option(
            min=0, metavar="SECONDS", help="Limit the time between two poses between which others are interpolated."
        ),
    ] = 0.5,
    voxel: Annotated[
        float | None,
        typer.Option(
            metavar="METERS",
            help=f"Set the distance of the grid points; {_VOXEL_M:g} by default, with --marks {OBJECT_VOXEL_M:g}.",
        ),
    ] = None,
    max_depth: Annotated[
        float, typer.Option(min=0, metavar="METERS", help="Skip depth beyond it; 0 skips nothing.")
    ] = 0.0,
    every: Annotated[int, typer.Option(min=1, metavar="N", help="Use one of N pairs.")] = 1,
    refine: Annotated[
        bool,
        typer.Option("--refine", help="Match each image with the surface fused before it, which refines its pose."),
    ] = False,
    min_piece: Annotated[
        int, typer.Option(min=0, metavar="N", help="Keep connected pieces of so many triangles.")
    ] = 100,
    fill: Annotated[
        float,
        typer.Option(
            min=0,
            metavar="METERS",
            help="Set the largest diameter of holes that are filled where no ray has crossed them.",
        ),
    ] = 0.0,
    memory: Annotated[int, typer.Option(min=1, metavar="MIB", help="Limit the memory of the volume.")] = 2048,
    camera_info: CameraInfo = None,
    matcher: Matcher = None,
    param: Params = None,
    params_file: ParamsFile = None,
    start: Start = 0.0,
    duration: Duration = 0.0,
    left: Left = None,
    right: Right = None,
    side_by_side: SideBySide = False,
    preview: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Write views of the surface from three sides as a PNG.")
    ] = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Fuse the depth of all pairs of a bag or dataset, with poses of the camera, to one surface.

    The surface is that of a volume of signed distances, on a grid of voxels near what was measured. Poses
    between two stamps are interpolated; a pair without a pose is left out and counted. Depth counts by its standard
    deviation. What a ray has crossed is empty, so that points between two surfaces disappear.

    Exit codes are 0 for success, 1 for an error, 2 for wrong usage and 3 where some pairs were skipped.

    \b
    Examples:
      stereo-depth fuse sequences/07 -o street.ply --voxel 0.1 --max-depth 25
      stereo-depth fuse V1_01_easy -o room.glb --every 5 --fill 0.1
      stereo-depth fuse drive.mcap -o drive.glb --poses /odom --voxel 0.05 --preview drive.png
      stereo-depth fuse drive.mcap -o drive.las --poses trajectory.txt --pose-frame camera
    """
    of_bag = is_bag(place) or place.is_file()
    if not of_bag:
        refuse_ignored(context, _OF_BAGS, "with a folder", "leave it out")
    check_ending(output, MESH_ENDS)
    require_png("--preview", preview)
    views = None
    if not of_bag and is_rgbd(place):
        refuse_ignored(context, _OF_PAIRS, "with color and depth images", "leave it out")
        views = open_views(place, camera_info or (), intrinsics, depth_unit, depth_sigma)
    else:
        refuse_ignored(context, _OF_VIEWS, "without color and depth images", "leave it out")
    if views is not None and marks is not None:
        refuse_ignored(context, _OF_POSES, "with --marks", "leave it out")
        voxel_m, paths = OBJECT_VOXEL_M if voxel is None else voxel, (output, preview, json_file)
        fuse_marked(views, marks, voxel_m, depth_sigma, memory * 2**20, paths, overwrite=overwrite)
        return
    file = read_parameters(params_file)
    given = given_parameters(param or (), matcher, file=file, stages=_STAGES, names=("disparity_sigma_px",))
    values = {**file, **given, **camera_info_values(camera_info if of_bag else None, given)}
    config = pipeline_config(values)
    volume = SurfaceVolume(_VOXEL_M if voxel is None else voxel, most_bytes=memory * 2**20)
    max_gap_ns = round(1e9 * max_gap)
    if of_bag:
        urls = config.camera_info
        files = camera_info_paths(urls.left_camera_info_url, urls.right_camera_info_url)
        known = _poses_of_bag(place, poses, max_gap_ns, pose_frame, world_frame)
        _check(output, preview, json_file, overwrite, [*bag_files(place), *known.files], params_file, values)
        prepare_kernels(config.matching)
        selection = BagSelection(place, left, right, start, duration, side_by_side, files)
        sequence: Sequence = BagSequence(selection, config)
    elif views is not None:
        chosen = views.poses if poses is None else Path(poses)
        if chosen is None:
            raise _no_poses(place, "give one, or the image of a sheet of dots", ("poses", "marks"))
        known = poses_of_file(chosen, max_gap_ns)
        sequence = RangeSequence(views, depth_sigma)
        _check(output, preview, json_file, overwrite, [*sequence.files, *known.files], params_file, values)
        prepare_kernels()
    else:
        posed = open_posed(place, camera_info or (), side_by_side=side_by_side)
        chosen = posed.poses if poses is None else Path(poses)
        if chosen is None:
            raise _no_poses(place, "give one", ("poses",))
        known = poses_of_file(chosen, max_gap_ns, pose_frame, posed)
        sequence = DatasetSequence(posed, config)
        _check(output, preview, json_file, overwrite, [*sequence.files, *known.files], params_file, values)
        prepare_kernels(config.matching)
    refinement = PoseRefinement(volume) if refine else None
    further = {} if refinement is None else {"each": refinement}
    with progress_bar("fusing") as progress:
        report = fuse_sequence(
            sequence, known, volume, every=every, max_depth_m=max_depth or math.inf, progress=progress, **further
        )
    surface = volume.surface(fewest_triangles=min_piece, largest_hole_m=fill)
    if not len(surface.mesh.triangles):
        raise no_surface_error(report, surface, volume.voxel_m).about(place)
    written = write_mesh(output, surface.mesh, z_up=report.z_up, overwrite=overwrite)
    if preview is not None:
        title = f"{output.name}: {report.fused} pairs, {len(surface.mesh.points_m)} points"
        save_png(preview, fused_plot(surface.mesh, title, z_up=report.z_up), overwrite=overwrite)
    result = _Result(report, surface, volume, known, refinement, written, preview)
    parameters = {"parameters": provenance(config, report.rig, sequence=place)}
    show(result.tables(), result.to_json() | parameters, json_file, overwrite=overwrite)
    for text in report.warnings:
        warn(text)
    if report.skipped:
        tell(f"error: {report.skipped} pairs skipped: see the warnings above")
        raise typer.Exit(EXIT_INCOMPLETE)


def _no_poses(place: Path, remedy: str, settings: tuple[str, ...]) -> ConfigError:
    return ConfigError("has no file of poses of its own", subject=str(place), remedy=remedy, settings=settings)


def _check(
    output: Path,
    preview: Path | None,
    json_file: Path | None,
    overwrite: bool,
    inputs: list[Path],
    params_file: Path | None,
    values: dict[str, Any],
) -> None:
    outputs = [output, *([preview] if preview is not None else [])]
    inputs = [*inputs, *parameter_files(params_file, values)]
    check_outputs(outputs, inputs, reports=[json_file], overwrite=overwrite)


def _poses_of_bag(
    bag: Path, poses: str | None, max_gap_ns: int, pose_frame: str | None, world_frame: str | None
) -> CameraPoses:
    """The poses of a topic, or of a file; without a name, of the only topic of poses.

    Raises:
        TopicError: several topics, or none.
    """
    found = pose_topics(bag)
    if poses is not None and poses not in found and Path(poses).exists():
        if world_frame is not None:
            raise ConfigError(
                "world_frame has no effect: the poses are those of a file",
                value=world_frame,
                remedy="leave it out",
                settings=("world_frame",),
            )
        return poses_of_file(Path(poses), max_gap_ns, pose_frame)
    if poses is None:
        single = [name for name, msgtype in found.items() if msgtype != TREE_TYPE] or [*found]
        if len(single) != 1:
            raise TopicError(
                f"{len(single)} topics hold poses: {', '.join(single)}" if single else "no topic holds poses",
                subject=str(bag),
                value=single,
                limit=1,
                remedy="name one of them, or a file of poses" if single else "give a file of poses",
                settings=("poses",),
            )
        poses = single[0]
    return poses_of_topic(poses, read_bag_poses(bag, poses, max_gap_ns), max_gap_ns, pose_frame, world_frame)


@dataclass(frozen=True)
class _Result:
    report: FuseReport
    surface: FusedSurface
    volume: SurfaceVolume
    poses: CameraPoses
    refinement: PoseRefinement | None
    written: WrittenFile
    preview: Path | None

    def to_json(self) -> dict[str, Any]:
        refined = {} if self.refinement is None else self.refinement.to_json()
        return {
            **self.report.to_json(),
            **refined,
            "poses": self.poses.text,
            "voxel_m": self.volume.voxel_m,
            "blocks": self.volume.block_count,
            "memory_bytes": self.volume.memory_bytes,
            "pieces_removed": self.surface.pieces,
            "holes_filled": self.surface.filled,
            "holes_open": self.surface.open,
            "surfaces": [self.written.to_json()],
        }

    def tables(self) -> Iterator[TextTable]:
        facts, report, mesh = facts_table(), self.report, self.surface.mesh
        facts.add_row("pairs fused", f"{report.fused} of {report.pairs}")
        if report.without_pose:
            facts.add_row("without pose", str(report.without_pose))
        if report.skipped:
            facts.add_row("skipped", str(report.skipped))
        facts.add_row("poses", self.poses.text)
        if self.refinement is not None:
            facts.add_row("poses refined", self.refinement.text)
        facts.add_row("way of the camera", f"{report.path_m:.2f} m")
        left_out = (
            (report.too_far, "too far"),
            (report.uncertain, "too uncertain"),
            (report.alone, "between surfaces"),
        )
        reasons = ", ".join(f"{count} {why}" for count, why in left_out if count)
        facts.add_row("pixels fused", f"{report.used}{f'; left out: {reasons}' if reasons else ''}")
        if not math.isnan(report.apart):
            facts.add_row("images differ by", f"{report.apart:.2f} widths of the truncation band")
        memory = f"{self.volume.block_count} blocks, {self.volume.memory_bytes / 2**20:.0f} MiB"
        facts.add_row("volume", f"voxels of {self.volume.voxel_m:g} m, {memory}")
        facts.add_row("time of a fusion", f"{report.integrate_ms:.0f} ms")
        if self.surface.pieces:
            facts.add_row("small pieces removed", f"{self.surface.pieces}, {self.surface.piece_triangles} triangles")
        if self.surface.filled or self.surface.open:
            facts.add_row(
                "holes filled", f"{self.surface.filled}; {self.surface.open} stay open, rays have crossed them"
            )
        low, high = np.percentile(mesh.points_m, [0.5, 99.5], axis=0)
        facts.add_row("size", " x ".join(f"{extent:.2f}" for extent in high - low) + " m, 99 % of the points")
        sigma_mm = 1e3 * float(np.nanmedian(mesh.sigma_m))
        facts.add_row(
            "standard deviation", f"median {sigma_mm:.2f} mm along the rays, if images have independent errors"
        )
        add_files(facts, [self.written])
        if self.preview is not None:
            facts.add_row("preview", str(self.preview))
        yield facts

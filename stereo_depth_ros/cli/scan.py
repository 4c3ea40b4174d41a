# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth scan`: computes depth from images of projected patterns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.active.shown_patterns import read_patterns
from stereo_depth_ros.active.structured_light.manifest import MANIFEST
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.sources import is_bag
from stereo_depth_ros.bags.writer import check_bag_output
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo
from stereo_depth_ros.cli.export import SurfaceExport, add_files
from stereo_depth_ros.cli.given import given_parameters, refuse_ignored
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.options import BagOutput, Export, Json, Overwrite, Params, new_app
from stereo_depth_ros.cli.output import progress_bar, show, tell
from stereo_depth_ros.cli.run_report import truth_text
from stereo_depth_ros.cli.scan_stripe import MOVING, StripeScanOptions, scan_stripe
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.evaluation.bag_score import BagScore, score_disparity
from stereo_depth_ros.offline.captures import CaptureSource
from stereo_depth_ros.offline.scan import ScanSummary, scan_captures
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.plots.preview import save_preview

__all__ = ["app"]

app = new_app()

_KINDS = ("patterns", "stripe")
_STRIPE_OPTIONS = (
    *("laser", "motion", "motion_topic", "joint", "step", "turntable", "linear_axis", "moving", "ambient"),
)


@app.command(cls=CommandWithCameraInfo)
def scan(
    context: typer.Context,
    place: Annotated[
        Path, typer.Argument(metavar="BAG|DIR", help="Read the captures of this bag, or of this folder of images.")
    ],
    output: BagOutput,
    kind: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Look for this light: {', '.join(_KINDS)}.",
            autocompletion=lambda: [*_KINDS],
        ),
    ] = "patterns",
    patterns: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help=f"Read the patterns from this manifest, or color stripes from an image; default is DIR/{MANIFEST}.",
        ),
    ] = None,
    camera_info: CameraInfo = None,
    projector: Annotated[
        bool,
        typer.Option(
            "--projector", help="Take the right camera of the calibration as the projector; only the left has images."
        ),
    ] = False,
    left: Annotated[
        str | None,
        typer.Option(metavar="TOPIC|GLOB", help="Read the left images from this topic or these files."),
    ] = None,
    right: Annotated[
        str | None,
        typer.Option(metavar="TOPIC|GLOB", help="Read the right images from this topic or these files."),
    ] = None,
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="Read both images from one topic, or from each file of the folder.")
    ] = False,
    settle: Annotated[
        int, typer.Option(min=0, max=100, metavar="N", help="Skip this number of images after each change of pattern.")
    ] = 1,
    laser: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Read the light plane of a stripe from this file.")
    ] = None,
    motion: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Read the motion of object, sensor or stripe from this table."),
    ] = None,
    motion_topic: Annotated[
        str | None,
        typer.Option(metavar="TOPIC", help="Read the motion from this topic of the bag: JointState or PoseStamped."),
    ] = None,
    joint: Annotated[
        str, typer.Option(metavar="NAME", help="Read this joint of the motion topic; the first one by default.")
    ] = "",
    step: Annotated[
        float | None,
        typer.Option(metavar="MM|DEGREES", help="Take equal steps of the motion from image to image."),
    ] = None,
    turntable: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Read the axis of a turntable from this file.")
    ] = None,
    linear_axis: Annotated[
        str | None,
        typer.Option(metavar='"X Y Z"', help="Set the direction of a linear motion, in the frame of the camera."),
    ] = None,
    moving: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Set what moves: {', '.join(MOVING)}; the sensor is camera and laser, the plane the light alone.",
            autocompletion=lambda: [*MOVING],
        ),
    ] = "object",
    ambient: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Take this image without the stripe as ambient light.")
    ] = None,
    export: Export = None,
    param: Params = None,
    preview: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Write the image and the depth of the first scan as a PNG.")
    ] = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Compute depth from images of projected light: of patterns, or of a light stripe.

    With --kind patterns, images of two cameras, or of one camera and a projector, are matched by their codes. The
    images of a folder are in the order of the manifest, which `stereo-depth patterns` writes; for two cameras they are
    named as for `stereo-depth convert images`. In a bag the patterns are those that /scan/shown announces; without it
    they are found by their changes. With color stripes every capture is a scan of its own.

    With --kind stripe, each image has one profile, on the light plane of --laser (of one camera), by the disparities of
    two cameras (--camera-info LEFT RIGHT), or by both. The motion between the images is that of a table, of a topic, or
    of equal --step. In a table, the first column is image (a file name) or stamp_s, the others are position_m,
    position_mm, angle_deg, angle_rad, or x,y,z,qx,qy,qz,qw. The axis of an angle is that of --turntable, the direction
    of a position is --linear-axis. The bag receives the cloud of each profile and the merged cloud.

    \b
    Examples:
      stereo-depth scan captures -o scan.mcap --patterns patterns/patterns.json --camera-info left.yaml right.yaml
      stereo-depth scan drive.mcap -o scan.mcap --patterns stripes.png
      stereo-depth scan captures -o scan.mcap --projector --camera-info camera.yaml projector.yaml --preview scan.png
      stereo-depth scan images -o scan.mcap --kind stripe --laser laser.yaml --turntable turntable.yaml --step 1.125 \\
        --export scan.ply --preview scan.png --param stripe_max_depth:=0.5
    """
    if kind not in _KINDS:
        raise ConfigError(
            f"kind {kind!r} is not one of {', '.join(_KINDS)}", value=kind, limit=_KINDS, settings=("kind",)
        )
    if moving not in MOVING:
        raise ConfigError(
            f"moving {moving!r} is not one of {', '.join(MOVING)}", value=moving, limit=MOVING, settings=("moving",)
        )
    if kind == "stripe":
        refuse_ignored(context, ("patterns", "projector", "settle"), "with --kind stripe", "leave it out")
        scan_stripe(
            StripeScanOptions(
                place,
                output,
                laser,
                tuple(camera_info or ()),
                left,
                right,
                side_by_side,
                motion,
                motion_topic,
                joint,
                step,
                turntable,
                linear_axis,
                moving,
                ambient,
                tuple(param or ()),
                export,
                preview,
                json_file,
                overwrite,
            )
        )
        return
    refuse_ignored(context, _STRIPE_OPTIONS, "with --kind patterns", "add --kind stripe, or leave it out")
    manifest = patterns or _manifest_beside(place)
    source = CaptureSource(
        BagSelection(place, left, right, side_by_side=side_by_side, camera_files=tuple(camera_info or ())), projector
    )
    files = [*source.files, manifest]
    surfaces = SurfaceExport(export, overwrite=overwrite)
    check_bag_output(output, files, more=[surfaces.name], reports=[json_file, preview], overwrite=overwrite)
    shown, config = read_patterns(manifest), pipeline_config(given_parameters(param or (), None, file={}))
    prepare_kernels()
    first: list[StereoResult] = []

    def keep(result: StereoResult) -> None:
        if not first:
            first.append(result)
        surfaces.add(result)

    with surfaces, progress_bar("reading") as progress:
        scans = scan_captures(
            source,
            shown,
            output,
            config,
            settle=settle,
            overwrite=overwrite,
            progress=progress,
            each=keep,
        )
    if preview is not None:
        image = first[0]
        save_preview(preview, image.rectified.left, image.depth_m, place.name, overwrite=overwrite)
    score = score_disparity(output, place) if is_bag(place) and not projector else None
    values = {"scans": [each.to_json() for each in scans], "output": str(output)} | surfaces.to_json()
    show(_tables(scans, score, [("bag", output), ("image", preview)], surfaces), values, json_file, overwrite=overwrite)
    if len(scans) > 1:
        tell(f"{len(scans)} scans in {place}")


def _manifest_beside(place: Path) -> Path:
    found = place / MANIFEST
    if place.is_dir() and not is_bag(place) and found.exists():
        return found
    raise ConfigError(
        f"no manifest of the patterns is given, and there is no {MANIFEST} beside the images",
        subject=str(place),
        remedy="name the one that `stereo-depth patterns` has written",
        settings=("patterns",),
    )


def _tables(
    scans: Sequence[ScanSummary],
    score: BagScore | None,
    written: Sequence[tuple[str, Path | None]],
    surfaces: SurfaceExport,
) -> Iterator[TextTable]:
    table = plain_table("stamp:r", "valid:r", "median depth:r", "without depth", "decoding and matching:r")
    for each in scans:
        counts = sorted(((count, name) for name, count in each.reasons.items() if count), reverse=True)
        names = ", ".join(f"{name.lower().replace('_', ' ')} {count}" for count, name in counts)
        ms = each.timings_ms["decode"] + each.timings_ms["match"]
        table.add_row(
            f"{each.stamp_ns / 1e9:.3f}",
            f"{100 * each.valid_fraction:.1f} %",
            f"{each.median_depth_m:.3f} m",
            names,
            f"{ms:.0f} ms",
        )
    yield table
    facts = facts_table()
    if score is not None and score.truth_frames:
        facts.add_row("error against truth", truth_text(score))
    for what, path in written:
        if path is not None:
            facts.add_row(f"{what} written", str(path))
    add_files(facts, surfaces.written)
    yield facts

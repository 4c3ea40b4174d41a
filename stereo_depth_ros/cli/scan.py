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
from stereo_depth_ros.cli.given import given_parameters
from stereo_depth_ros.cli.options import BagOutput, Json, Overwrite, Params, new_app
from stereo_depth_ros.cli.output import prepare_kernels, progress_bar, show, tell
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.offline.captures import CaptureSource
from stereo_depth_ros.offline.scan import ScanSummary, scan_captures
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.plots.preview import save_preview

__all__ = ["app"]

app = new_app()


@app.command(cls=CommandWithCameraInfo)
def scan(
    place: Annotated[
        Path, typer.Argument(metavar="BAG|DIR", help="Read the captures of this bag, or of this folder of images.")
    ],
    output: BagOutput,
    patterns: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help=f"Read the patterns from this manifest, or color stripes from an image; the default is DIR/{MANIFEST}.",
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
    param: Params = None,
    preview: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Write the image and the depth of the first scan as a PNG.")
    ] = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Compute depth from images of projected patterns, of two cameras or of one camera and a projector.

    The images of a folder are in the order of the manifest, which `stereo-depth patterns` writes; for two cameras they
    are named as for `stereo-depth convert images`. In a bag the patterns are those that /scan/shown announces; without
    it they are found by their changes. With color stripes every capture is a scan of its own.

    \b
    Examples:
      stereo-depth scan captures -o scan.mcap --patterns patterns/patterns.json --camera-info left.yaml right.yaml
      stereo-depth scan drive.mcap -o scan.mcap --patterns stripes.png
      stereo-depth scan captures -o scan.mcap --projector --camera-info camera.yaml projector.yaml --preview scan.png
    """
    manifest = patterns or _manifest_beside(place)
    source = CaptureSource(
        BagSelection(place, left, right, side_by_side=side_by_side, camera_files=tuple(camera_info or ())), projector
    )
    files = [*source.files, manifest]
    check_bag_output(output, files, reports=[json_file, preview], overwrite=overwrite)
    check_outputs([], files, reports=[preview], overwrite=overwrite)
    shown, config = read_patterns(manifest), pipeline_config(given_parameters(param or (), None, file={}))
    prepare_kernels()
    first: list[StereoResult] = []
    with progress_bar("reading") as progress:
        scans = scan_captures(
            source,
            shown,
            output,
            config,
            settle=settle,
            overwrite=overwrite,
            progress=progress,
            each=lambda result: first.append(result) if not first else None,
        )
    if preview is not None:
        image = first[0]
        save_preview(preview, image.rectified.left, image.depth_m, place.name, overwrite=overwrite)
    values = {"scans": [each.to_json() for each in scans], "output": str(output)}
    show(_tables(scans, output, preview), values, json_file, overwrite=overwrite)
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


def _tables(scans: Sequence[ScanSummary], output: Path, preview: Path | None) -> Iterator[TextTable]:
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
    facts.add_row("bag written", str(output))
    if preview is not None:
        facts.add_row("image written", str(preview))
    yield facts

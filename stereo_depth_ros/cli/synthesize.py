# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth synthesize`: writes a synthetic bag with exact ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.active.shown_patterns import pattern_images
from stereo_depth_ros.bags.writer import check_bag_output
from stereo_depth_ros.cli.given import refuse_ignored
from stereo_depth_ros.cli.options import Overwrite, new_app
from stereo_depth_ros.cli.output import progress_bar, tell
from stereo_depth_ros.synthetic.bag import write_scan_bag, write_synthetic_bag
from stereo_depth_ros.synthetic.projection import SyntheticScanner
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

__all__ = ["app"]

app = new_app()


@app.command()
def synthesize(
    context: typer.Context,
    output: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="Write this bag.")],
    frames: Annotated[int, typer.Option(min=1, metavar="N", help="Render this number of pairs.")] = 20,
    width: Annotated[int, typer.Option(min=16, metavar="PIXELS", help="Render images of this width.")] = 640,
    height: Annotated[int, typer.Option(min=16, metavar="PIXELS", help="Render images of this height.")] = 480,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Set the random seed of textures and noise.")] = 7,
    patterns: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Render a scan: a table under the patterns of this manifest or image of color stripes."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a synthetic stereo bag with exact ground truth: a room seen by a moving rig of verged, distorted cameras.

    With --patterns it is a scan, one pair for each pattern of a projector: surfaces that are smooth, glossy, black and
    in shadow, and walls that light each other, with noise, ambient light, and the gamma and the blur of a projector.

    \b
    Examples:
      stereo-depth synthesize room.mcap --frames 50 --seed 3
      stereo-depth synthesize captures.mcap --patterns patterns/patterns.json
    """
    if patterns is not None:
        refuse_ignored(context, ["frames"], "with --patterns", "leave it out, each pattern has one pair")
        _synthesize_scan(output, patterns, (width, height), seed, overwrite)
        return
    with progress_bar("rendering") as progress:
        sequence = SyntheticSequence(frames, width, height, seed)
        write_synthetic_bag(output, sequence, overwrite=overwrite, progress=progress)
    tell(f"{frames} pairs written to {output}")


def _synthesize_scan(output: Path, patterns: Path, size: tuple[int, int], seed: int, overwrite: bool) -> None:
    check_bag_output(output, [patterns], overwrite=overwrite)
    images = pattern_images(patterns)
    height, width = images[0].shape[:2]
    with progress_bar("rendering") as progress:
        scanner = SyntheticScanner(*size, (width, height), seed=seed)
        write_scan_bag(output, scanner, images, overwrite=overwrite, progress=progress)
    tell(f"{len(images)} pairs written to {output}")

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth synthesize`: writes a synthetic bag with exact ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.cli.options import Overwrite, new_app
from stereo_depth_ros.cli.output import progress_bar, tell
from stereo_depth_ros.synthetic.bag import write_synthetic_bag
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

__all__ = ["app"]

app = new_app()


@app.command()
def synthesize(
    output: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="Write this bag.")],
    frames: Annotated[int, typer.Option(min=1, metavar="N", help="Render this number of pairs.")] = 20,
    width: Annotated[int, typer.Option(min=16, metavar="PIXELS", help="Render images of this width.")] = 640,
    height: Annotated[int, typer.Option(min=16, metavar="PIXELS", help="Render images of this height.")] = 480,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Set the random seed of textures and noise.")] = 7,
    overwrite: Overwrite = False,
) -> None:
    """Write a synthetic stereo bag with exact ground truth: a room seen by a moving rig of verged, distorted cameras.

    \b
    Example:
      stereo-depth synthesize room.mcap --frames 50 --seed 3
    """
    with progress_bar("rendering") as progress:
        sequence = SyntheticSequence(frames, width, height, seed)
        write_synthetic_bag(output, sequence, overwrite=overwrite, progress=progress)
    tell(f"{frames} pairs written to {output}")

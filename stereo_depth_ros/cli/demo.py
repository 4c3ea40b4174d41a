# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth demo`: plays the sample bag through the live graph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.cli.given import refuse_files
from stereo_depth_ros.cli.live_run import run_live
from stereo_depth_ros.cli.options import Json, Matcher, Overwrite, Separate, new_app
from stereo_depth_ros.cli.run_report import finish_run
from stereo_depth_ros.config.values import parse_assignments
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.files.installed_files import installed_files
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.plots.bag_preview import save_bag_preview
from stereo_depth_ros.replay.options import ReplayOptions

__all__ = ["app"]

app = new_app()


@app.command()
def demo(
    output_dir: Annotated[Path, typer.Option(metavar="DIR", help="Write the bag and the image to this folder.")] = Path(
        "out"
    ),
    separate: Separate = False,
    matcher: Matcher = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Play the sample bag through the live graph, print the results, and write a bag and an image.

    \b
    Examples:
      stereo-depth demo
      stereo-depth demo --output-dir /tmp/demo --matcher sgbm
    """
    refuse_files("--output-dir", output_dir)
    bag, output, image = _sample_bag(), output_dir / "demo.mcap", output_dir / "demo.png"
    check_outputs([output, image], [bag], reports=[json_file], overwrite=overwrite)
    options = ReplayOptions(bag=str(bag), output=str(output), overwrite=overwrite)
    result = run_live(options, "separate" if separate else "fused", parse_assignments((), matcher), None)
    save_bag_preview(output, image, f"{bag.name}: {matcher or 'sgm'}", overwrite=overwrite)
    finish_run(result, json_file, overwrite, image=image)


def _sample_bag() -> Path:
    for bag in installed_files("bags/*.mcap"):
        return bag
    raise BagError(
        "the installation has no sample bag",
        subject=str(Path(__file__).parents[2] / "bags"),
        remedy="make one with `stereo-depth synthesize` and play it with `stereo-depth replay`",
    )

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth info`: lists the contents of a bag and states whether it is usable for stereo depth."""

from __future__ import annotations

from dataclasses import replace

import typer

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.camera_files.reading import rig_file_paths
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo
from stereo_depth_ros.cli.errors import error_text
from stereo_depth_ros.cli.info_tables import info_tables, info_values
from stereo_depth_ros.cli.options import Bag, Json, Left, Overwrite, Right, SideBySide, new_app
from stereo_depth_ros.cli.output import EXIT_ERROR, show, tell, warn
from stereo_depth_ros.diagnosis.stereo_choice import choose_topics
from stereo_depth_ros.files.output import check_outputs

__all__ = ["app"]

app = new_app()


@app.command(cls=CommandWithCameraInfo)
def info(
    bag: Bag,
    camera_info: CameraInfo = None,
    left: Left = None,
    right: Right = None,
    side_by_side: SideBySide = False,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """List the contents of a bag and state whether it is usable for stereo depth, and if not, why.

    Exit codes are 0 for a usable bag, 1 for a bag that is not usable or an error, and 2 for wrong usage.

    \b
    Examples:
      stereo-depth info drive.mcap
      stereo-depth info drive.mcap --json - | jq .problems
      stereo-depth info drive.mcap --camera-info camchain.yaml
    """
    files = rig_file_paths(camera_info) if camera_info else []
    check_outputs((), [*bag_files(bag), *files], reports=[json_file], overwrite=overwrite)
    given = tuple(camera_info or ())
    chosen, choice = choose_topics(BagSelection(bag, left, right, side_by_side=side_by_side, camera_files=given))
    found = inspect_bag(
        bag, left=chosen.left, right=chosen.right, side_by_side=side_by_side, camera_files=chosen.camera_files
    )
    if choice:
        found = replace(found, warnings=(choice, *found.warnings))
    show(info_tables(found), info_values(found), json_file, overwrite=overwrite)
    for text in found.warnings:
        warn(text)
    for problem in found.problems:
        tell(f"problem: {error_text(problem)}")
    if not found.usable:
        raise typer.Exit(EXIT_ERROR)

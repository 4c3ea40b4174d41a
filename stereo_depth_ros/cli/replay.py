# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth replay`: plays a bag through the live graph and records the outputs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.bags.writer import check_bag_output
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo, camera_info_values
from stereo_depth_ros.cli.given import PIPELINE, given_parameters, refuse_ignored
from stereo_depth_ros.cli.live_run import run_live
from stereo_depth_ros.cli.options import (
    Bag,
    BagOutput,
    Duration,
    Json,
    Left,
    Matcher,
    Overwrite,
    Params,
    ParamsFile,
    Right,
    Separate,
    SideBySide,
    Start,
    Strict,
    Views,
    new_app,
)
from stereo_depth_ros.cli.output import parameter_files
from stereo_depth_ros.cli.run_report import finish_run
from stereo_depth_ros.config.values import Value, parse_assignments, read_params_file
from stereo_depth_ros.config.view_topics import check_views
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.replay.options import ReplayOptions

__all__ = ["app"]

app = new_app()


@app.command(cls=CommandWithCameraInfo)
def replay(
    context: typer.Context,
    bag: Bag,
    output: BagOutput,
    separate: Separate = False,
    camera_info: CameraInfo = None,
    matcher: Matcher = None,
    param: Params = None,
    params_file: ParamsFile = None,
    rate: Annotated[
        float, typer.Option(min=0, metavar="FACTOR", help="Limit the speed relative to the recording; 0 sets no limit.")
    ] = 0.0,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Send pairs at the rate of the recording; late pairs are dropped.")
    ] = False,
    clock: Annotated[bool, typer.Option("--clock", help="Publish /clock; the nodes use simulated time.")] = False,
    loop: Annotated[int, typer.Option(min=1, metavar="N", help="Play the bag this number of times.")] = 1,
    start: Start = 0.0,
    duration: Duration = 0.0,
    left: Left = None,
    right: Right = None,
    side_by_side: SideBySide = False,
    in_flight: Annotated[
        int, typer.Option(min=1, max=100, metavar="N", help="Process up to this number of pairs at a time.")
    ] = 1,
    health: Annotated[bool, typer.Option("--health", help="Run the calibration monitor as well.")] = False,
    auto_correct: Annotated[
        bool, typer.Option("--auto-correct", help="Run the calibration monitor and rectify with its correction.")
    ] = False,
    strict: Strict = False,
    view: Views = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Play a bag through the live graph in the current ROS_DOMAIN_ID and record the outputs.

    A pair is sent when all outputs of the previous one have been received, so that nothing is lost; with --realtime
    pairs are sent at the rate of the recording and may be lost.

    Exit codes are 0 for success, 1 for an error, 2 for wrong usage and 3 where outputs were lost.

    \b
    Examples:
      stereo-depth replay drive.mcap -o depth.mcap
      stereo-depth replay drive.mcap -o depth.mcap --separate --matcher sgbm --param disparity_range:=128
      stereo-depth replay drive.mcap -o depth.mcap --view view/image --param view_position:=0.3
      stereo-depth replay drive.mcap -o depth.mcap --auto-correct --param health_rate:=0
      stereo-depth replay drive.mcap -o depth.mcap --realtime --rate 0.5 --clock --start 10 --duration 5
    """
    options = ReplayOptions(
        bag=str(bag),
        output=str(output),
        overwrite=overwrite,
        rate=rate,
        realtime=realtime,
        clock=clock,
        loop=loop,
        start_seconds=start,
        duration_seconds=duration,
        left_topic=left or "",
        right_topic=right or "",
        side_by_side=side_by_side,
        in_flight=in_flight,
        strict=strict,
        views=",".join(check_views(view or ())),
    )
    if realtime:
        refuse_ignored(context, ["in_flight"], "with --realtime", "leave out one of them")
    shape = "separate" if separate else "fused"
    stages = (*PIPELINE, "view") if view else PIPELINE
    values, monitor = _parameters(param or (), matcher, params_file, health, auto_correct, stages)
    values |= camera_info_values(camera_info, values)
    check_bag_output(
        output, [*bag_files(bag), *parameter_files(params_file, values)], reports=[json_file], overwrite=overwrite
    )
    result = run_live(options, shape, values, params_file, monitor)
    finish_run(result, json_file, overwrite)


def _parameters(
    texts: Sequence[str],
    matcher: str | None,
    params_file: Path | None,
    health: bool,
    auto_correct: bool,
    stages: tuple[str, ...],
) -> tuple[dict[str, Value], Literal["", "report", "correct"]]:
    """The values given, and what the calibration monitor does."""
    wanted = parse_assignments(texts).get("auto_correct")
    if auto_correct and wanted is False:
        raise ConfigError(
            "--auto-correct and --param auto_correct:=false contradict each other", remedy="give one of them"
        )
    monitor: Literal["", "report", "correct"] = "report" if health else ""
    if auto_correct or wanted:
        monitor = "correct"
    file = read_params_file(params_file) if params_file is not None else {}
    values = given_parameters(
        texts,
        matcher,
        file={**file, "auto_correct": monitor == "correct"},
        stages=(*stages, "health") if monitor else stages,
        remedies={"health": "add --health or --auto-correct", "view": "add --view"},
    )
    return values, monitor

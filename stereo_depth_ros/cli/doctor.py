# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth doctor`: examines a stereo setup and states faults and remedies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.camera_files.reading import rig_file_paths
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo
from stereo_depth_ros.cli.errors import param_options
from stereo_depth_ros.cli.given import given_parameters, is_given, refuse_ignored
from stereo_depth_ros.cli.options import Json, Left, Matcher, Overwrite, Params, Right, SideBySide, new_app
from stereo_depth_ros.cli.output import parameter_files, progress_bar, show
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table
from stereo_depth_ros.config.values import Value, pipeline_config
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.diagnosis.bag_survey import survey_bag
from stereo_depth_ros.diagnosis.doctor import diagnose
from stereo_depth_ros.diagnosis.finding import Level
from stereo_depth_ros.diagnosis.survey import StereoSetup
from stereo_depth_ros.diagnosis.verdict import Diagnosis
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.matching import Matcher as StereoMatcher
from stereo_depth_ros.replay.graph_processes import require_ros

__all__ = ["app"]

app = new_app()

_EXIT_ERROR, _EXIT_SKIPPED = 1, 3
_SHOWN = {
    Level.OK: ("ok", "green"),
    Level.SKIPPED: ("skipped", "yellow"),
    Level.WARNING: ("warning", "yellow"),
    Level.ERROR: ("error", "red"),
}


@app.command(cls=CommandWithCameraInfo)
def doctor(
    context: typer.Context,
    bag: Annotated[
        Path | None,
        typer.Argument(metavar="BAG", help="Examine this bag: an .mcap, .db3 or ROS 1 .bag file, or a rosbag2 folder."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Examine the running graph in the current ROS_DOMAIN_ID.")
    ] = False,
    camera_info: CameraInfo = None,
    left: Left = None,
    right: Right = None,
    side_by_side: SideBySide = False,
    matcher: Matcher = None,
    param: Params = None,
    left_namespace: Annotated[
        str, typer.Option(metavar="NAME", help="Look for the left camera in this namespace, with --live.")
    ] = "left",
    right_namespace: Annotated[
        str, typer.Option(metavar="NAME", help="Look for the right camera in this namespace, with --live.")
    ] = "right",
    seconds: Annotated[
        float, typer.Option(min=0.1, max=3600, metavar="SECONDS", help="Listen for this time, with --live.")
    ] = 5.0,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Examine the calibration, time stamps and images of a stereo setup, and state faults and remedies.

    In a bag, topics are detected as by `info`. With --live they are image_raw (or else image_rect) and camera_info in
    the two namespaces, unless --left and --right are given.

    With --matcher or --param, the disparities of a matcher are compared with those of features: a constant offset or
    scale, as of a network that is not exported as it was trained, is named.

    Exit codes are 0 without a fault (there may be warnings), 1 for a fault or if nothing can be examined, 2 for wrong
    usage, and 3 where no fault was found but some checks were skipped.

    \b
    Examples:
      stereo-depth doctor drive.mcap
      stereo-depth doctor drive.mcap --json - | jq '.findings[] | select(.level == "error")'
      stereo-depth doctor --live --left-namespace stereo/left --right-namespace stereo/right --seconds 10
      stereo-depth doctor drive.mcap --matcher onnx --param onnx_model:=network.onnx --param disparity_range:=192
    """
    if live == (bag is not None):
        raise ConfigError(
            "both BAG and --live are given" if live else "neither BAG nor --live is given",
            remedy="give a BAG, or --live for the running graph",
        )
    _check_options(context, live)
    values = given_parameters(param or (), matcher, stages=("matching",))
    files = rig_file_paths(camera_info) if camera_info else []
    inputs = [*(bag_files(bag) if bag is not None else ()), *files, *parameter_files(None, values)]
    check_outputs((), inputs, reports=[json_file], overwrite=overwrite)
    chosen = _chosen(values)
    if bag is not None:
        with progress_bar("reading") as progress:
            given = tuple(camera_info or ())
            selection = BagSelection(bag, left, right, side_by_side=side_by_side, camera_files=given)
            setup = survey_bag(selection, progress)
    else:
        setup = _listen(left, right, left_namespace, right_namespace, seconds)
    with progress_bar("matching features") as progress:
        diagnosis = diagnose(setup, progress, chosen)
    show(_tables(diagnosis), diagnosis.to_json(), json_file, overwrite=overwrite)
    if diagnosis.level is Level.ERROR:
        raise typer.Exit(_EXIT_ERROR)
    if diagnosis.skipped:
        raise typer.Exit(_EXIT_SKIPPED)


def _chosen(values: Mapping[str, Value]) -> StereoMatcher | None:
    """The matcher that is examined too; None where no parameter of one is given."""
    if not values:
        return None
    config = pipeline_config(values).matching
    # Without --matcher the command starts without the compiler.
    from stereo_depth_ros.cli.kernels import prepare_kernels
    from stereo_depth_ros.matching import matcher_from_config

    prepare_kernels(config)
    return matcher_from_config(config)


def _check_options(context: typer.Context, live: bool) -> None:
    if live:
        refuse_ignored(context, ["camera_info"], "with --live", "set the parameters of the nodes, or record a bag")
        refuse_ignored(context, ["side_by_side"], "with --live", "record a bag, or split the images in the driver")
    else:
        refuse_ignored(context, ("seconds", "left_namespace", "right_namespace"), "with a bag", "leave it out")
    for side in ("left", "right"):
        if is_given(context, side):
            remedy = "give the topic or the namespace"
            refuse_ignored(context, [f"{side}_namespace"], f"beside --{side}, which is the whole topic", remedy)


def _listen(
    left: str | None, right: str | None, left_namespace: str, right_namespace: str, seconds: float
) -> StereoSetup:
    require_ros()
    from stereo_depth_ros.nodes.graph_survey import camera_topics, survey_graph

    left_names = (left,) if left else camera_topics(left_namespace)
    right_names = (right,) if right else camera_topics(right_namespace)
    with progress_bar("listening") as progress:
        return survey_graph(left_names, right_names, seconds, progress)


def _tables(diagnosis: Diagnosis) -> Iterator[TextTable]:
    """The verdict, the remedies of faults and warnings, and all findings."""
    facts = facts_table()
    setup = diagnosis.setup
    facts.add_row("verdict", diagnosis.verdict)
    facts.add_row("images", ", ".join(dict.fromkeys((setup.left.image_topic, setup.right.image_topic))))
    facts.add_row("examined", f"{len(setup.pairs)} pairs of {setup.source}")
    if diagnosis.search:
        facts.add_row("search", param_options(diagnosis.search))
    yield facts
    remedies: dict[str, list[str]] = {}
    for finding in sorted(diagnosis.findings, key=lambda finding: -finding.level):
        if finding.level is not Level.OK and finding.remedy:
            text = f"{finding.remedy} ({param_options(finding.settings)})" if finding.settings else finding.remedy
            remedies.setdefault(text, []).append(finding.check)
    if remedies:
        table = plain_table("check", "remedy", title="what to do")
        for remedy, checks in remedies.items():
            table.add_row(", ".join(checks), remedy)
        yield table
    findings = plain_table("check", "verdict", "found", "limit")
    for finding in diagnosis.findings:
        word, style = _SHOWN[finding.level]
        findings.add_row(finding.check, Text(word, style=style), finding.value, finding.limit)
    yield findings

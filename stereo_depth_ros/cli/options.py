# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.config.more_topics import MORE_TOPICS
from stereo_depth_ros.config.output_topics import DEFAULT_OUTPUTS, OUTPUT_NAMES
from stereo_depth_ros.config.view_topics import VIEW_TOPICS

__all__ = [
    "Also",
    "Bag",
    "BagOutput",
    "Compression",
    "Duration",
    "Every",
    "Export",
    "Json",
    "Left",
    "Matcher",
    "Outputs",
    "Overwrite",
    "Params",
    "ParamsFile",
    "Right",
    "Separate",
    "SideBySide",
    "Start",
    "Strict",
    "Views",
    "new_app",
]

Bag = Annotated[
    Path, typer.Argument(metavar="BAG", help="Read this bag: an .mcap, .db3 or ROS 1 .bag file, or a rosbag2 folder.")
]
BagOutput = Annotated[Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="Write the outputs to this bag.")]
Json = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - prints it instead of tables.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing output files.")]
_TOPIC = "Read the {} images from this topic; it is detected by default."
Left = Annotated[str | None, typer.Option("--left", metavar="TOPIC", help=_TOPIC.format("left"))]
Right = Annotated[str | None, typer.Option("--right", metavar="TOPIC", help=_TOPIC.format("right"))]
SideBySide = Annotated[
    bool,
    typer.Option("--side-by-side", help="Read both images from one topic, the left one from its left half."),
]
Start = Annotated[float, typer.Option(min=0, metavar="SECONDS", help="Skip this time at the beginning of the bag.")]
Duration = Annotated[
    float, typer.Option(min=0, metavar="SECONDS", help="Read the bag for this time only; 0 reads to the end.")
]
Export = Annotated[
    Path | None,
    typer.Option(
        "--export",
        metavar="FILE",
        help="Write the first result, or each one where the name has {stamp}, as a mesh (.ply, .glb), a cloud "
        "(.cloud.ply, .pcd, .las, .laz), a depth image (.png, 16 bits of mm) or arrays (.npz).",
    ),
]
Matcher = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"Compute disparities with this matcher: {', '.join(MATCHERS)}.",
        autocompletion=lambda: [*MATCHERS],
    ),
]
Prior = Annotated[
    str | None,
    typer.Option(
        metavar="TOPIC",
        help="Take the points of this range sensor, PointCloud2, LaserScan or a depth Image of the bag, as a prior of "
        "the disparities, for sgm.",
    ),
]
Extrinsics = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Read the pose of the range sensor in this file, YAML or the calibration of KITTI, instead of /tf_static "
        "and /tf.",
    ),
]
Params = Annotated[
    list[str] | None,
    typer.Option("--param", "-p", metavar="NAME:=VALUE", help="Set a parameter; the option may be repeated."),
]
ParamsFile = Annotated[
    Path | None,
    typer.Option(
        "--params-file",
        metavar="FILE",
        help="Take parameters from this ROS file, sections /**, stereo_depth_node and those of the separate nodes; "
        "--param and --matcher take precedence.",
    ),
]
Separate = Annotated[
    bool, typer.Option("--separate", help="Start one process for each node instead of one for all stages.")
]

Strict = Annotated[
    bool,
    typer.Option(
        "--strict", help="Keep nothing, and end with an error, where the first pairs do not fit the calibration."
    ),
]
Also = Annotated[
    list[str] | None,
    typer.Option(
        "--also",
        metavar="TOPIC",
        help=f"Write this output too; the option may be repeated: {', '.join(MORE_TOPICS)}.",
        autocompletion=lambda: [*MORE_TOPICS],
    ),
]
Outputs = Annotated[
    list[str] | None,
    typer.Option(
        "--outputs",
        metavar="NAME,...",
        help=f"Write these outputs, {', '.join(OUTPUT_NAMES)} or topics, and the camera infos; rect is the left "
        f"rectified image, and {','.join(DEFAULT_OUTPUTS)} are written by default. Points have 32 bytes a pixel, 29 MB "
        "a pair at 1280x720, before compression.",
        autocompletion=lambda: [*OUTPUT_NAMES],
    ),
]
Compression = Annotated[
    Literal["none", "lz4", "zstd"], typer.Option("--compression", help="Write the bag with this compression.")
]
Every = Annotated[int, typer.Option(min=1, metavar="K", help="Process the first one of every K pairs only.")]
Views = Annotated[
    list[str] | None,
    typer.Option(
        "--view",
        metavar="TOPIC",
        help=f"Write this view too; the option may be repeated: {', '.join(VIEW_TOPICS)}.",
        autocompletion=lambda: [*VIEW_TOPICS],
    ),
]


def new_app(help: str | None = None) -> typer.Typer:
    """A Typer in the style of all commands: plain help, no pretty tracebacks."""
    return typer.Typer(
        no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False, help=help
    )

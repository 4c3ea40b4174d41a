# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth ...`: the command line.

Exit codes: 0 fine, 1 an error that is told in one line, 2 wrong usage, 3 outputs were lost.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from stereo_depth_ros.bags.info import inspect_bag
from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.cli.calibrate import calibrate_command
from stereo_depth_ros.cli.convert import convert_app, synthesize
from stereo_depth_ros.cli.doctor import doctor_command
from stereo_depth_ros.cli.evaluate import evaluate_command
from stereo_depth_ros.cli.output import messages, progress_bar, show
from stereo_depth_ros.cli.rectify import rectify_command
from stereo_depth_ros.cli.rig import rig_command
from stereo_depth_ros.cli.tables import info_tables, info_values, parameters_table, parameters_values, result_tables
from stereo_depth_ros.config.values import Value, parse_assignments, pipeline_config, read_params_file
from stereo_depth_ros.core.errors import BagError, StereoDepthError
from stereo_depth_ros.core.installed_files import installed_files
from stereo_depth_ros.matching import MATCHERS
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.offline.report import RunReport
from stereo_depth_ros.plots.bag_preview import save_bag_preview
from stereo_depth_ros.replay.graph_processes import require_ros
from stereo_depth_ros.replay.options import ReplayOptions

__all__ = ["app", "main"]

EXIT_ERROR, EXIT_LOST = 1, 3

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    help="Stereo depth for ROS 2: from bags and live graphs to disparity, depth and point clouds.",
)
app.add_typer(convert_app, name="convert")
app.command()(synthesize)
app.command("evaluate")(evaluate_command)
app.command("calibrate")(calibrate_command)
app.command("doctor")(doctor_command)
app.command("rectify")(rectify_command)
app.command("rig")(rig_command)

Bag = Annotated[Path, typer.Argument(metavar="BAG", help="MCAP or .db3 file, or rosbag2 folder.")]
Output = Annotated[
    Path, typer.Option("-o", "--output", metavar="OUT.mcap", help="Bag to write; replaced if it exists.")
]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - is stdout.")]
Left = Annotated[str | None, typer.Option("--left", metavar="TOPIC", help="Left image topic; found by itself.")]
Right = Annotated[str | None, typer.Option("--right", metavar="TOPIC", help="Right image topic; found by itself.")]
Start = Annotated[float, typer.Option(min=0, help="Seconds of the bag to leave out at the beginning.")]
Duration = Annotated[float, typer.Option(min=0, help="Seconds of the bag to read; 0 is all.")]
Matcher = Annotated[str | None, typer.Option(metavar="NAME", help=f"{', '.join(MATCHERS)}: sets stereo_algorithm.")]
Params = Annotated[
    list[str] | None, typer.Option("--param", "-p", metavar="NAME:=VALUE", help="A parameter; may be repeated.")
]
ParamsFile = Annotated[Path | None, typer.Option(metavar="FILE", help="ROS parameter file; --param wins over it.")]


@app.command()
def info(bag: Bag, left: Left = None, right: Right = None, json_file: Json = None) -> None:
    """Say what is in a bag, whether stereo depth can be made of it, and why not.

    \b
    Examples:
      stereo-depth info drive.mcap
      stereo-depth info drive.mcap --json - | jq .problems
    """
    found = inspect_bag(bag, left=left, right=right)
    show(info_tables(found), info_values(found), json_file)
    for text in found.warnings:
        messages.print(f"warning: {text}")
    for text in found.problems:
        messages.print(f"problem: {text}")
    if not found.usable:
        raise typer.Exit(EXIT_ERROR)


@app.command()
def replay(
    bag: Bag,
    output: Output,
    separate: Annotated[bool, typer.Option("--separate", help="One process a node; fused by default.")] = False,
    matcher: Matcher = None,
    param: Params = None,
    params_file: ParamsFile = None,
    rate: Annotated[float, typer.Option(min=0, help="At most so many times the bag's speed; 0 is no limit.")] = 0.0,
    realtime: Annotated[bool, typer.Option("--realtime", help="Send by the clock; what is late is dropped.")] = False,
    clock: Annotated[bool, typer.Option("--clock", help="Publish /clock; the nodes use it.")] = False,
    loop: Annotated[int, typer.Option(min=1, help="How often the bag is played.")] = 1,
    start: Start = 0.0,
    duration: Duration = 0.0,
    left: Left = None,
    right: Right = None,
    in_flight: Annotated[int, typer.Option(min=1, max=100, help="Pairs that may be on their way.")] = 1,
    health: Annotated[bool, typer.Option("--health", help="Watch the calibration with health_node, too.")] = False,
    auto_correct: Annotated[
        bool, typer.Option("--auto-correct", help="And rectify with what health_node corrects.")
    ] = False,
    json_file: Json = None,
) -> None:
    """Play a bag through the live graph, in this ROS_DOMAIN_ID, and record what comes out.

    The next pair is sent when all outputs of the one before have come: nothing is lost, unless --realtime asks for it.

    \b
    Examples:
      stereo-depth replay drive.mcap -o depth.mcap
      stereo-depth replay drive.mcap -o depth.mcap --separate --matcher sgbm --param disparity_range:=128
      stereo-depth replay drive.mcap -o depth.mcap --auto-correct --param health_rate:=0
      stereo-depth replay drive.mcap -o depth.mcap --realtime --rate 0.5 --clock --start 10 --duration 5
    """
    options = ReplayOptions(
        bag=str(bag),
        output=str(output),
        rate=rate,
        realtime=realtime,
        clock=clock,
        loop=loop,
        start_seconds=start,
        duration_seconds=duration,
        left_topic=left or "",
        right_topic=right or "",
        in_flight=in_flight,
    )
    shape, values = "separate" if separate else "fused", parse_assignments(param or (), matcher)
    watch: Literal["", "watch", "correct"] = "watch" if health else ""
    if auto_correct or values.get("auto_correct"):
        watch = "correct"
    result = _replay(options, shape, values, params_file, watch)
    _finish(result, json_file)


@app.command()
def process(
    bag: Bag,
    output: Output,
    matcher: Matcher = None,
    param: Params = None,
    params_file: ParamsFile = None,
    start: Start = 0.0,
    duration: Duration = 0.0,
    left: Left = None,
    right: Right = None,
    json_file: Json = None,
) -> None:
    """Compute a bag without a graph: the same outputs as replay, without ROS.

    \b
    Examples:
      stereo-depth process drive.mcap -o depth.mcap
      stereo-depth process drive.mcap -o depth.mcap --matcher sgbm --params-file stereo_depth.yaml
    """
    _check_output(bag, output)
    values = {**(read_params_file(params_file) if params_file else {}), **parse_assignments(param or (), matcher)}
    selection = BagSelection(bag, left, right, start, duration)
    with progress_bar("computing") as progress:
        result = process_bag(selection, output, pipeline_config(values), progress)
    _finish(result, json_file)


@app.command()
def demo(
    output_dir: Annotated[Path, typer.Option(metavar="DIR", help="Where the bag and the image go.")] = Path("out"),
    separate: Annotated[bool, typer.Option("--separate", help="One process a node; fused by default.")] = False,
    matcher: Matcher = None,
    json_file: Json = None,
) -> None:
    """Play the sample bag through the live graph; prints a table, writes a bag and an image.

    \b
    Examples:
      stereo-depth demo
      stereo-depth demo --output-dir /tmp/demo --matcher sgbm
    """
    bag, output = _sample_bag(), output_dir / "demo.mcap"
    options = ReplayOptions(bag=str(bag), output=str(output))
    result = _replay(options, "separate" if separate else "fused", parse_assignments((), matcher), None)
    image = output_dir / "demo.png"
    save_bag_preview(output, image, f"{bag.name}: {matcher or 'sgm'}")
    _finish(result, json_file, image=image)


@app.command()
def parameters(json_file: Json = None) -> None:
    """List every parameter with default, range and meaning.

    \b
    Example:
      stereo-depth parameters
    """
    show([parameters_table()], parameters_values(), json_file)


def main() -> None:
    """The console script: one line for a known error."""
    signal.signal(signal.SIGTERM, _interrupt)  # the nodes that were started are stopped, as after Ctrl-C
    try:
        app()
    except StereoDepthError as error:
        messages.print(f"error: {error}", markup=False)
        sys.exit(EXIT_ERROR)


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def _replay(
    options: ReplayOptions,
    shape: str,
    values: dict[str, Value],
    params_file: Path | None,
    health: Literal["", "watch", "correct"] = "",
) -> RunReport:
    _check_output(Path(options.bag), Path(options.output))
    require_ros()
    from stereo_depth_ros.nodes.replay.live import replay_through_graph

    config = pipeline_config({**(read_params_file(params_file) if params_file else {}), **values})
    with progress_bar(f"playing, {shape}") as progress:
        return replay_through_graph(options, shape, values, config, progress, params_file, health)


def _finish(result: RunReport, json_file: Path | None, image: Path | None = None) -> None:
    values = result.to_json() | ({"image": str(image)} if image else {})
    show(result_tables(result, image), values, json_file)
    for text in result.warnings:
        messages.print(f"warning: {text}", markup=False)
    if result.skipped or (result.lost and not result.realtime):
        messages.print(f"error: {result.skipped} pairs left out, {result.lost} outputs lost: see the warnings above")
        raise typer.Exit(EXIT_LOST)


def _check_output(bag: Path, output: Path) -> None:
    if bag.resolve() == output.resolve():
        raise BagError(f"{output} is the bag that is read: write to another file")
    if output.suffix != ".mcap":
        raise BagError(f"{output} does not end in .mcap: outputs are written as MCAP, name it {output.stem}.mcap")


def _sample_bag() -> Path:
    for bag in installed_files("bags/*.mcap"):
        return bag
    raise BagError(f"no sample bag belongs to {__file__}: make one with `stereo-depth synthesize bags/room.mcap`")


if __name__ == "__main__":
    main()

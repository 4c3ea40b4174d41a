# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth process`: computes the depth of a bag without a ROS graph."""

from __future__ import annotations

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.projected_sweeps import SensorTopic
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.bags.writer import check_bag_output
from stereo_depth_ros.camera_files.urls import camera_info_paths
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo, camera_info_values
from stereo_depth_ros.cli.export import SurfaceExport
from stereo_depth_ros.cli.given import PIPELINE, check_takes_prior, given_parameters
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.options import (
    Also,
    Bag,
    BagOutput,
    Compression,
    Duration,
    Every,
    Export,
    Extrinsics,
    Json,
    Left,
    Matcher,
    Outputs,
    Overwrite,
    Params,
    ParamsFile,
    Prior,
    Right,
    SideBySide,
    Start,
    Strict,
    Views,
    new_app,
)
from stereo_depth_ros.cli.output import parameter_files, progress_bar
from stereo_depth_ros.cli.params_file import read_parameters
from stereo_depth_ros.cli.run_report import finish_run
from stereo_depth_ros.config import ViewConfig
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.config.more_topics import check_more_topics
from stereo_depth_ros.config.output_topics import DEFAULT_OUTPUTS, output_topics
from stereo_depth_ros.config.values import pipeline_config, stage_config
from stereo_depth_ros.config.view_topics import check_views
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.offline.engine import process_bag

__all__ = ["app"]

app = new_app()


@app.command(cls=CommandWithCameraInfo)
def process(
    bag: Bag,
    output: BagOutput,
    camera_info: CameraInfo = None,
    prior: Prior = None,
    extrinsics: Extrinsics = None,
    matcher: Matcher = None,
    param: Params = None,
    params_file: ParamsFile = None,
    start: Start = 0.0,
    duration: Duration = 0.0,
    every: Every = 1,
    left: Left = None,
    right: Right = None,
    side_by_side: SideBySide = False,
    strict: Strict = False,
    outputs: Outputs = None,
    compression: Compression = "lz4",
    view: Views = None,
    also: Also = None,
    export: Export = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Compute the depth of a bag without a ROS graph: messages as those of replay, ROS is not needed.

    Disparity, depth and the left rectified image are written, or what --outputs names; points are written if asked for.

    With --export the depth is written to files too, as a mesh, a cloud or an image: of the first pair, or of each one
    where the name has {stamp}, which becomes the stamp in nanoseconds.

    With --prior the matcher sgm is guided by the points of a range sensor in the bag, see docs/range_sensor.md.

    Exit codes are 0 for success, 1 for an error, 2 for wrong usage and 3 where some pairs were skipped.

    \b
    Examples:
      stereo-depth process drive.mcap -o depth.mcap
      stereo-depth process drive.mcap -o depth.mcap --matcher sgbm --params-file stereo_depth.yaml
      stereo-depth process drive.mcap -o depth.mcap --camera-info left.yaml right.yaml
      stereo-depth process drive.mcap -o depth.mcap --outputs depth,points --compression zstd --every 5
      stereo-depth process drive.mcap -o depth.mcap --view anaglyph --view disparity_color
      stereo-depth process drive.mcap -o depth.mcap --also confidence --also error_depth
      stereo-depth process drive.mcap -o depth.mcap --prior /velodyne_points
      stereo-depth process drive.mcap -o depth.mcap --export 'meshes/{stamp}.glb'
    """
    file = read_parameters(params_file)
    views = check_views(view or ())
    stages = (*PIPELINE, "view") if views else PIPELINE
    written = output_topics([*(outputs or DEFAULT_OUTPUTS), *check_more_topics(also or ())])
    depends = export is not None or any(topic.startswith("error_") for topic in written)
    names = ("disparity_sigma_px",) if depends else ()
    given = given_parameters(
        param or (), matcher, file=file, stages=stages, names=names, remedies={"view": "add --view"}
    )
    values = {**file, **given, **camera_info_values(camera_info, given)}
    surfaces = SurfaceExport(export, overwrite=overwrite)
    inputs = [*bag_files(bag), *parameter_files(params_file, values), *([extrinsics] if extrinsics else [])]
    check_bag_output(output, inputs, more=[surfaces.name], reports=[json_file], overwrite=overwrite)
    config = pipeline_config(values)
    urls = config.camera_info
    files = camera_info_paths(urls.left_camera_info_url, urls.right_camera_info_url)
    if extrinsics is not None and prior is None:
        raise ConfigError(
            "--extrinsics has no effect without --prior", value=str(extrinsics), remedy="add --prior TOPIC"
        )
    if prior is not None:
        check_takes_prior([[*MATCHERS][config.matching.stereo_algorithm]])
    prepare_kernels(config.matching)
    selection = BagSelection(bag, left, right, start, duration, side_by_side, files)
    drawn = dict.fromkeys(views, stage_config(ViewConfig, values))
    sensor = None if prior is None else SensorTopic(prior, extrinsics)
    with surfaces, progress_bar("computing") as progress:
        result = process_bag(
            selection,
            output,
            config,
            progress,
            drawn,
            overwrite=overwrite,
            strict=strict,
            each=surfaces.add,
            prior=sensor,
            outputs=written,
            compression=compression,
            every=every,
        )
    finish_run(result, json_file, overwrite, surfaces=surfaces)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth convert ...`: writes datasets and folders of images as bags, calibrations as those of ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.calibration.calibration_files import write_camera
from stereo_depth_ros.camera_files.reading import read_rig_files, rig_file_paths
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo, ImageSize, parse_size
from stereo_depth_ros.cli.given import refuse_files, refuse_ignored
from stereo_depth_ros.cli.options import Overwrite, new_app
from stereo_depth_ros.cli.output import progress_bar, tell, warn
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.datasets.dataset import StereoDataset
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.images import ImagesDataset
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.datasets.middlebury import MiddleburyDataset
from stereo_depth_ros.datasets.to_bag import convert_dataset
from stereo_depth_ros.files.output import check_outputs

__all__ = ["app"]

app = new_app(
    "Write a dataset as a stereo bag with camera infos and, if the dataset has it, ground truth on /truth/disparity."
)

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Read the dataset in this folder.")]
Output = Annotated[Path, typer.Argument(metavar="OUT.mcap", help="Write this bag.")]
Rate = Annotated[float, typer.Option(metavar="HZ", help="Set the pairs per second.")]


@app.command()
def middlebury(
    context: typer.Context,
    folder: Folder,
    output: Output,
    calibration: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Use this calib.txt instead of that of DIR.")
    ] = None,
    focal_px: Annotated[
        float | None,
        typer.Option(metavar="PIXELS", help="Set the focal length if there is no calib.txt; needs --baseline-m."),
    ] = None,
    baseline_m: Annotated[
        float | None,
        typer.Option(metavar="METERS", help="Set the baseline if there is no calib.txt; needs --focal-px."),
    ] = None,
    doffs: Annotated[
        float | None, typer.Option(metavar="PIXELS", help="Set the difference cx_right - cx_left, as in calib.txt.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Convert a Middlebury or ETH3D scene.

    Middlebury scenes of 2001 to 2014 and ETH3D two-view scenes are read. The bag contains one pair.

    \b
    Examples:
      stereo-depth convert middlebury Motorcycle-perfect motorcycle.mcap
      stereo-depth convert middlebury cones cones.mcap --focal-px 500 --baseline-m 0.16
    """
    if (focal_px is None) != (baseline_m is None):
        given, missing = ("--focal-px", "--baseline-m") if baseline_m is None else ("--baseline-m", "--focal-px")
        raise ConfigError(f"{given} has no effect without {missing}", value=given, remedy="give both")
    if focal_px is not None:
        refuse_ignored(context, ["calibration"], "beside --focal-px and --baseline-m", "give the file or the numbers")
    elif calibration is not None or (folder / "calib.txt").exists():
        refuse_ignored(context, ["doffs"], "beside a calib.txt, which has it", "leave it out")
    dataset = MiddleburyDataset(
        folder, calibration_file=calibration, focal_px=focal_px, baseline_m=baseline_m, doffs=doffs
    )
    _convert(dataset, output, 10.0, overwrite)


@app.command()
def kitti(folder: Folder, output: Output, overwrite: Overwrite = False) -> None:
    """Convert a KITTI sequence or benchmark.

    Odometry and raw sequences and the training pairs of the stereo benchmarks are read. Where there are sweeps of the
    laser scanner, they are written as /velodyne_points with its pose on /tf_static: the truth of evaluate --truth.

    \b
    Example:
      stereo-depth convert kitti dataset/sequences/00 kitti00.mcap
    """
    _convert(KittiDataset(folder), output, 10.0, overwrite)


@app.command()
def euroc(folder: Folder, output: Output, overwrite: Overwrite = False) -> None:
    """Convert a sequence of EuRoC MAV or TUM VI.

    The bag contains the raw, distorted pairs with the time stamps of the dataset.

    \b
    Example:
      stereo-depth convert euroc V1_01_easy v1_01.mcap
    """
    _convert(EurocDataset(folder), output, 20.0, overwrite)


@app.command(cls=CommandWithCameraInfo)
def images(
    folder: Folder,
    output: Output,
    camera_info: CameraInfo = None,
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="Read both images from each file, the left one from its left half.")
    ] = False,
    rate: Rate = 10.0,
    overwrite: Overwrite = False,
) -> None:
    """Convert a folder of images.

    The calibration is that of left.yaml and right.yaml in DIR, or of other files. The images are in DIR/left and
    DIR/right, or named left*.png and right*.png. Two images form a pair if their names differ only in left and right,
    l and r, cam0 and cam1 or image_0 and image_1, and in leading zeros. Images without a partner are skipped with a
    warning. Left and right images of different sizes, each with its calibration, are extended to one size with black at
    the right and at the bottom.

    \b
    Example:
      stereo-depth convert images recording drive.mcap --camera-info left.yaml right.yaml --rate 15
    """
    dataset = ImagesDataset(folder, camera_info or (), side_by_side=side_by_side)
    _convert(dataset, output, rate, overwrite)


@app.command()
def calibration(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="LEFT RIGHT", help="Read these calibration files, one that holds both, or their folder."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Write the files to this folder.")],
    size: ImageSize = None,
    overwrite: Overwrite = False,
) -> None:
    """Write left.yaml and right.yaml of camera_calibration.

    The files are those of camera_calibration, Kalibr, OpenCV, camodocal, VINS, DepthAI and others, see
    docs/calibration.md. Where they hold no rectification, it is computed as for a new calibration.

    \b
    Examples:
      stereo-depth convert calibration camchain.yaml -o calibration
      stereo-depth convert calibration intrinsics.yml extrinsics.yml --size 640x480 -o calibration
    """
    refuse_files("--output", output)
    paths, wanted = [output / "left.yaml", output / "right.yaml"], parse_size(size)
    check_outputs(paths, rig_file_paths(files), overwrite=overwrite)
    rig = read_rig_files(files, wanted)
    if wanted is not None:
        rig.check_image(*wanted, "--size")
    output.mkdir(parents=True, exist_ok=True)
    for path, camera, side in zip(paths, (rig.left, rig.right), ("left", "right"), strict=True):
        write_camera(path, camera, side, overwrite=overwrite)
    names = " and ".join(dict.fromkeys(rig.topics))
    tell(
        f"{rig.left.distortion_model}, {rig.width}x{rig.height}, baseline {rig.baseline_m:.6g} m of {names} written to "
        f"{paths[0]} and {paths[1]}"
    )


def _convert(dataset: StereoDataset, output: Path, rate_hz: float, overwrite: bool) -> None:
    with progress_bar("converting") as progress:
        count = convert_dataset(dataset, output, rate_hz=rate_hz, overwrite=overwrite, progress=progress)
    for text in getattr(dataset, "warnings", []):
        warn(text)
    skipped = getattr(dataset, "skipped", 0)
    tell(f"{count} pairs written to {output}" + (f", {skipped} images skipped" if skipped else ""))

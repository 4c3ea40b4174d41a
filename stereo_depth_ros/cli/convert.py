# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth convert ...`: bags from datasets and folders of images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.cli.options import Overwrite, new_app
from stereo_depth_ros.cli.output import messages, progress_bar
from stereo_depth_ros.datasets.dataset import StereoDataset
from stereo_depth_ros.datasets.euroc import EurocDataset
from stereo_depth_ros.datasets.images import ImagesDataset
from stereo_depth_ros.datasets.kitti import KittiDataset
from stereo_depth_ros.datasets.middlebury import MiddleburyDataset
from stereo_depth_ros.datasets.to_bag import convert_dataset

__all__ = ["app"]

app = new_app(
    "Write a dataset as a stereo bag, with camera infos and, where it is known, the truth on /truth/disparity."
)

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the dataset.")]
Output = Annotated[Path, typer.Argument(metavar="OUT.mcap", help="Bag to write.")]
Rate = Annotated[float, typer.Option(help="Pairs a second, where the dataset has no times.")]


@app.command()
def middlebury(
    folder: Folder,
    output: Output,
    calibration: Annotated[Path | None, typer.Option(help="A calib.txt in another place.")] = None,
    focal_px: Annotated[float | None, typer.Option(help="Focal length, with --baseline-m.")] = None,
    baseline_m: Annotated[float | None, typer.Option(help="Baseline, with --focal-px.")] = None,
    doffs: Annotated[float | None, typer.Option(help="Middlebury's cx_right - cx_left, px.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """A Middlebury (2001 to 2014) or ETH3D two-view scene: one pair.

    \b
    Examples:
      stereo-depth convert middlebury Motorcycle-perfect motorcycle.mcap
      stereo-depth convert middlebury cones cones.mcap --focal-px 500 --baseline-m 0.16
    """
    dataset = MiddleburyDataset(
        folder, calibration_file=calibration, focal_px=focal_px, baseline_m=baseline_m, doffs=doffs
    )
    _convert(dataset, output, 10.0, overwrite)


@app.command()
def kitti(folder: Folder, output: Output, rate: Rate = 10.0, overwrite: Overwrite = False) -> None:
    """A KITTI odometry or raw sequence, or the training pairs of a stereo benchmark.

    \b
    Example:
      stereo-depth convert kitti dataset/sequences/00 kitti00.mcap
    """
    _convert(KittiDataset(folder), output, rate, overwrite)


@app.command()
def euroc(folder: Folder, output: Output, overwrite: Overwrite = False) -> None:
    """A EuRoC MAV sequence: raw, distorted pairs with the times of the dataset.

    \b
    Example:
      stereo-depth convert euroc V1_01_easy v1_01.mcap
    """
    _convert(EurocDataset(folder), output, 20.0, overwrite)


@app.command()
def images(
    folder: Folder,
    output: Output,
    left_yaml: Annotated[Path | None, typer.Option(help="Calibration; DIR/left.yaml by default.")] = None,
    right_yaml: Annotated[Path | None, typer.Option(help="Calibration; DIR/right.yaml by default.")] = None,
    rate: Rate = 10.0,
    overwrite: Overwrite = False,
) -> None:
    """Images in DIR/left and DIR/right (or left*.png and right*.png) with the two files of camera_calibration.

    Names that differ in left and right, l and r, cam0 and cam1 or image_0 and image_1 only, and in leading zeros, make
    a pair. Images without a partner are left out and named.

    \b
    Example:
      stereo-depth convert images recording drive.mcap --left-yaml left.yaml --right-yaml right.yaml --rate 15
    """
    _convert(ImagesDataset(folder, left_yaml=left_yaml, right_yaml=right_yaml), output, rate, overwrite)


def _convert(dataset: StereoDataset, output: Path, rate_hz: float, overwrite: bool) -> None:
    with progress_bar("converting") as progress:
        count = convert_dataset(dataset, output, rate_hz=rate_hz, overwrite=overwrite, progress=progress)
    for text in getattr(dataset, "warnings", []):
        messages.print(f"warning: {text}", markup=False)
    left_out = getattr(dataset, "skipped", 0)
    messages.print(f"{count} pairs written to {output}" + (f", {left_out} images left out" if left_out else ""))

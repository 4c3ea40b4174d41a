# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views of a range camera (RGB-D) without a ROS graph: range images, fused by given poses or on a sheet of dots."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.core.errors import RegistrationError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.datasets.image_files import read_image
from stereo_depth_ros.datasets.rgbd import RgbdDataset, RgbdFrame
from stereo_depth_ros.geometry.robust import robust_sigma
from stereo_depth_ros.offline.sequence import SequencePair, SequenceView
from stereo_depth_ros.surfaces.marks import DotSheet
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.sheet_poses import SheetPoses, sheet_poses
from stereo_depth_ros.surfaces.solid import Box, Solid, SolidVolume

__all__ = ["DEPTH_SIGMA_M", "RangeSequence", "SheetReport", "fuse_on_sheet", "range_image", "read_sheet"]

# At 1 m: disparities of 0.08 px, a baseline of 50 mm and a focal length of 420 px (a RealSense D435 at 848x480).
DEPTH_SIGMA_M = 0.004
_ABOVE_SIGMAS = 4.0  # of the heights of the sheet: what is above is the object
_NEAR_SHEET = 12.0  # standard deviations of depth within which a height is one of the sheet
_MARGIN = 3.0  # voxels


@dataclass
class SheetReport:
    """Result of fusing views of an object on a sheet of dots.

    Attributes:
        views: number of views.
        fused: views whose pose is known.
        poses: of these.
        box: what is fused: above the sheet, inside of its borders.
        sheet_sigma_m: robust standard deviation of the heights that the depths give the sheet.
        apart: mean difference between a view and those before it, in widths of the truncation band.
        warnings: a sentence each.
    """

    views: int
    fused: int
    poses: SheetPoses
    box: Box
    sheet_sigma_m: float
    apart: float
    warnings: list[str] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain data."""
        return {
            "views": self.views,
            "fused": self.fused,
            "dots": int(np.count_nonzero(np.isfinite(self.poses.dots_m[:, 0]))),
            "reprojection_px": self.poses.reprojection_px,
            "dots_flatness_m": self.poses.flatness_m,
            "dots_spread_m": self.poses.spread_m,
            "sheet_size_m": list(self.poses.size_m),
            "sheet_sigma_m": self.sheet_sigma_m,
            "cut_height_m": float(self.box.low[2]),
            "apart": None if math.isnan(self.apart) else self.apart,
            "poses": [
                {"view": view, "sheet_from_camera": pose.matrix.tolist()}
                for view, pose in zip(self.poses.views, self.poses.poses, strict=True)
            ],
            "warnings": self.warnings,
        }


def read_sheet(path: Path) -> DotSheet:
    """The sheet of an image file.

    Raises:
        BagError: not a readable image.
        RegistrationError: it shows too few dots.
    """
    pixels = read_image(path)
    gray = pixels if pixels.ndim == 2 else pixels.min(axis=2)
    return DotSheet.of(np.ascontiguousarray(gray), str(path))


def range_image(frame: RgbdFrame, dataset: RgbdDataset, sigma_1m: float) -> RangeImage:
    """The range image of a frame; the standard deviation is that of a range camera that triangulates, and of rounding.

    sigma_Z = Z^2 sigma_d / (f B), which is ``sigma_1m`` at 1 m (Khoshelham and Elberink 2012, equation 10).

    Args:
        frame: of the dataset.
        dataset: its camera and the step of its depths.
        sigma_1m: standard deviation at 1 m, meters.
    """
    K = dataset.camera.K
    geometry = Triangulation(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), 0.0, 0.0)
    rounding = dataset.step_m / math.sqrt(12)
    sigma = np.hypot(np.float32(sigma_1m) * np.square(frame.depth_m), np.float32(rounding)).astype(np.float32)
    return RangeImage(frame.depth_m, sigma, geometry, frame.color)


class RangeSequence:
    """The views of a range camera, see :class:`Sequence`.

    Args:
        dataset: the views.
        sigma_1m: standard deviation of the depth at 1 m, meters.
    """

    def __init__(self, dataset: RgbdDataset, sigma_1m: float = DEPTH_SIGMA_M) -> None:
        self._dataset, self._sigma_1m = dataset, sigma_1m

    @property
    def files(self) -> list[Path]:
        """All files that are read."""
        return self._dataset.files

    @property
    def warnings(self) -> list[str]:
        """A sentence each."""
        return without_partner(self._dataset)

    @property
    def fault(self) -> None:
        """Pairs are not examined: there is one camera."""

    def __len__(self) -> int:
        return len(self._dataset)

    def __iter__(self) -> Iterator[SequencePair]:
        for number, stamp_ns in enumerate(self._dataset.stamps_ns):
            yield SequencePair(functools.partial(int, number), stamp_ns, functools.partial(self._view, number))

    def _view(self, number: int) -> SequenceView:
        frame = self._dataset[number]
        return SequenceView("", None, functools.partial(range_image, frame, self._dataset, self._sigma_1m))


def without_partner(dataset: RgbdDataset) -> list[str]:
    """A sentence about the images that have no partner; none where all have."""
    return [f"{dataset.skipped} images have no partner, and are left out"] * bool(dataset.skipped)


def fuse_on_sheet(
    dataset: RgbdDataset,
    sheet: DotSheet,
    voxel_m: float,
    *,
    sigma_1m: float = DEPTH_SIGMA_M,
    most_bytes: int = 2**31,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[SheetReport, Solid]:
    """Fuse the views of an object on a sheet of dots to a closed surface, in the frame of the sheet.

    What is beside the sheet, and what is not above it by more than the noise of its own depths, is cut away; the side
    on which the object stands is closed by a plane at that height.

    Args:
        dataset: the views; the object does not move on the sheet.
        sheet: the sheet.
        voxel_m: distance of the grid points, meters.
        sigma_1m: standard deviation of the depth at 1 m, meters.
        most_bytes: bound of the memory of the volume.
        progress: called with the views done and their number.

    Raises:
        RegistrationError: fewer than two views show the sheet, or nothing stands on it.
        ConfigError: the box above the sheet does not fit into the memory.
        BagError: a file that cannot be read.
    """
    frames = [dataset[number] for number in range(len(dataset))]
    images = [range_image(frame, dataset, sigma_1m) for frame in frames]
    poses = sheet_poses(images, sheet, [frame.name for frame in frames])
    known = [images[view] for view in poses.views]
    box, sheet_sigma = _box(known, poses, voxel_m)
    volume = SolidVolume(voxel_m, box, most_bytes=most_bytes)
    aparts = []
    for number, (image, pose) in enumerate(zip(known, poses.poses, strict=True)):
        progress(number, len(known))
        aparts.append(volume.integrate(image, pose).apart)
    finite = [value for value in aparts if not math.isnan(value)]
    apart = float(np.mean(finite)) if finite else math.nan
    warnings = [*(f"skipped, {error}" for error in poses.refused), *without_partner(dataset)]
    report = SheetReport(len(images), len(known), poses, box, sheet_sigma, apart, warnings)
    return report, volume.solid()


def _box(images: list[RangeImage], poses: SheetPoses, voxel_m: float) -> tuple[Box, float]:
    """What is above the sheet, and the robust standard deviation of the heights of the sheet, m."""
    half = np.array(poses.size_m) / 2
    heights = [points[:, 2] for points in _above(images, poses, half)]
    noise = [np.median(image.sigma_m[image.measured]) for image in images]
    near = max(_NEAR_SHEET * float(np.median(noise)), _MARGIN * voxel_m)
    all_heights = np.concatenate(heights)
    flat = all_heights[np.abs(all_heights) < near]
    sigma = robust_sigma(flat - np.median(flat)) if len(flat) else 0.0
    low = max(_ABOVE_SIGMAS * sigma, voxel_m)
    higher = all_heights[all_heights > low + _MARGIN * voxel_m]
    if len(higher) < 100:
        raise RegistrationError(
            f"nothing stands on the sheet: {len(higher)} measured points are above {1e3 * low:.1f} mm",
            value=len(higher),
            limit=100,
            remedy="put the object on the sheet, inside of the dots",
        )
    high = float(higher.max()) + _MARGIN * voxel_m
    return Box(np.array([-half[0], -half[1], low]), np.array([half[0], half[1], high])), sigma


def _above(images: list[RangeImage], poses: SheetPoses, half: F64) -> Iterator[F64]:
    """Of each image, the points above or below the sheet, float64 (N, 3), in its frame."""
    for image, pose in zip(images, poses.poses, strict=True):
        points = pose.apply(image.points()[image.measured].astype(np.float64))
        yield points[(np.abs(points[:, :2]) < half).all(axis=1)]

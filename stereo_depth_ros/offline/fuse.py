# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fusion without a ROS graph: the pairs of a sequence, with the poses of the camera, to one surface."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stereo_depth_ros.core.errors import BagError, CameraOrderError, ConfigError, StereoDepthError
from stereo_depth_ros.core.pose import Pose
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.diagnosis.opening import skipped_text
from stereo_depth_ros.offline.camera_poses import CameraPoses
from stereo_depth_ros.offline.sequence import Sequence
from stereo_depth_ros.surfaces.range_image import RangeImage
from stereo_depth_ros.surfaces.volume import FusedSurface, SurfaceVolume

__all__ = ["FuseReport", "fuse_sequence", "no_surface_error"]

_FAR_M = 1000.0  # from the origin: float32 coordinates of a file are coarser than 0.1 mm there
_APART = 0.4  # mean difference between images, in widths of the band: noise stays below a third, wrong poses are above


@dataclass
class FuseReport:
    """Result of a fusion.

    Attributes:
        pairs: pairs that were read; of each ``every`` pairs, one counts.
        fused: pairs that were fused.
        without_pose: pairs at whose time no pose is known.
        skipped: pairs that could not be processed.
        used, too_far, uncertain, alone: pixels, as of :class:`IntegratedImage`.
        apart: median over the images of the mean difference from those before, in widths of the band; NaN of one image.
        rig: of the last pair; None of a range camera.
        path_m: length of the way of the camera over the pairs that were fused, meters.
        up: float64 (3,), mean direction of the upper edge of the images in the world, of length 1 where there is one.
        origin_m: float64 (3,), what is subtracted from all coordinates, meters.
        integrate_ms: median time of a fusion, without that of the depth, milliseconds.
        warnings: a sentence each.
    """

    pairs: int = 0
    fused: int = 0
    without_pose: int = 0
    skipped: int = 0
    used: int = 0
    too_far: int = 0
    uncertain: int = 0
    alone: int = 0
    apart: float = math.nan
    rig: StereoRig | None = None
    path_m: float = 0.0
    up: F64 = field(default_factory=lambda: np.zeros(3))
    origin_m: F64 = field(default_factory=lambda: np.zeros(3))
    integrate_ms: float = math.nan
    warnings: list[str] = field(default_factory=list)

    @property
    def z_up(self) -> bool:
        """Whether the world has z up, as in robotics; otherwise y down, as in images."""
        return bool(self.up[2] > -self.up[1])

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain data."""
        names = ("pairs", "fused", "without_pose", "skipped", "used", "too_far", "uncertain", "alone", "path_m")
        values: dict[str, Any] = {name: getattr(self, name) for name in names}
        for name in ("apart", "integrate_ms"):
            value = getattr(self, name)
            values[name] = None if math.isnan(value) else value
        return values | {"origin_m": self.origin_m.tolist(), "z_up": self.z_up, "warnings": self.warnings}


def fuse_sequence(
    sequence: Sequence,
    poses: CameraPoses,
    volume: SurfaceVolume,
    *,
    every: int = 1,
    max_depth_m: float = math.inf,
    progress: Callable[[int, int], None] = lambda done, total: None,
    each: Callable[[RangeImage, Pose], Pose] = lambda image, pose: pose,
) -> FuseReport:
    """Compute the depth of the pairs whose pose is known, and fuse it.

    Args:
        sequence: the pairs.
        poses: of the left rectified camera.
        volume: what they are fused into.
        every: one of so many pairs is used.
        max_depth_m: depth beyond it is left out, meters.
        progress: called with the pairs done and about how many there are at most.
        each: called with every range image and its pose before it is fused; returns the pose to use.

    Raises:
        BagError: no pair could be fused.
        ConfigError: the volume would be larger than its bound.
        CameraOrderError: left and right are swapped.
        TopicError: the frame of the images is not connected with that of the poses.
    """
    report = FuseReport()
    refused: dict[str, str] = {}
    times_ms: list[float] = []
    aparts: list[float] = []
    last: Pose | None = None
    for number, pair in enumerate(sequence):
        progress(number, max(number, len(sequence)))
        if number % every:
            continue
        report.pairs += 1
        try:
            view = pair.read()
            pose = poses.at(pair.number, pair.stamp_ns, view.frame_id, view.rig)
            if pose is None:
                report.without_pose += 1
                continue
            image = view.compute()
        except CameraOrderError:
            raise
        except StereoDepthError as error:
            if _is_about_poses(error):
                raise
            report.skipped += 1
            refused.setdefault(type(error).__name__, skipped_text(pair.stamp_ns, error))
            continue
        if not report.fused:
            report.origin_m = _origin(pose)
        pose = each(image, Pose(pose.rotation, pose.translation_m - report.origin_m))
        start = time.perf_counter()
        done = _integrated(volume, image, pose, max_depth_m, (number + 1) / max(number + 1, len(sequence)))
        times_ms.append(1e3 * (time.perf_counter() - start))
        report.fused += 1
        report.rig = view.rig
        for name in ("used", "too_far", "uncertain", "alone"):
            setattr(report, name, getattr(report, name) + getattr(done, name))
        if not math.isnan(done.apart):
            aparts.append(done.apart)
        report.up -= pose.rotation[:, 1]
        report.path_m += 0.0 if last is None else float(np.linalg.norm(pose.translation_m - last.translation_m))
        last = pose
    if not report.fused:
        raise _nothing_fused(report, poses, [*refused.values()])
    report.up /= max(float(np.linalg.norm(report.up)), 1e-12)
    report.apart = statistics.median(aparts) if aparts else math.nan
    report.integrate_ms = statistics.median(times_ms)
    report.warnings = [*poses.warnings, *sequence.warnings, *refused.values(), *_warnings(report, volume.voxel_m)]
    if sequence.fault is not None:
        report.warnings.append(str(sequence.fault))
    return report


def no_surface_error(report: FuseReport, surface: FusedSurface, voxel_m: float) -> BagError:
    """No triangle is in a surface: what was left out."""
    counts = {"fused": report.used, "too far": report.too_far, "too uncertain": report.uncertain}
    pixels = ", ".join(
        f"{count} {name}" for name, count in {**counts, "between surfaces": report.alone}.items() if count
    )
    pieces = f"; {surface.pieces} pieces are too small" if surface.pieces else ""
    return BagError(
        f"no surface was found with voxels of {voxel_m:g} m: pixels {pixels or 'without depth'}{pieces}",
        value=report.used,
        remedy="set larger voxels" if report.uncertain > report.used else "set another depth or smaller pieces",
        settings=("voxel",) if report.uncertain > report.used else ("max_depth", "min_piece"),
    )


def _is_about_poses(error: StereoDepthError) -> bool:
    return bool({"poses", "pose_frame", "world_frame"} & {*error.settings})


def _origin(pose: Pose) -> F64:
    """What is subtracted from poses far from the origin of their world, in whole meters."""
    far = float(np.abs(pose.translation_m).max()) > _FAR_M
    return np.rint(pose.translation_m) if far else np.zeros(3)


def _integrated(volume: SurfaceVolume, image: RangeImage, pose: Pose, max_depth_m: float, share: float) -> Any:
    try:
        return volume.integrate(image, pose, max_depth_m=max_depth_m)
    except ConfigError as error:
        done = f" after {100 * share:.0f} % of the pairs" if share < 1 else ""
        raise ConfigError(
            f"{error.problem}{done}",
            subject=error.subject,
            value=error.value,
            limit=error.limit,
            remedy=error.remedy,
            settings=error.settings,
        ) from error


def _nothing_fused(report: FuseReport, poses: CameraPoses, refused: list[str]) -> BagError:
    reasons = [*refused]
    if report.without_pose:
        reasons.append(f"{report.without_pose} of {report.pairs} pairs have no pose ({poses.text})")
    return BagError(
        f"no pair could be fused: {'; '.join(reasons) or 'there are none'}",
        value=report.pairs,
        remedy="give poses at the times of the images" if report.without_pose else "examine the images with the doctor",
        settings=("poses", "max_gap") if report.without_pose else (),
    )


def _warnings(report: FuseReport, voxel_m: float) -> list[str]:
    texts = []
    if report.without_pose:
        texts.append(f"{report.without_pose} of {report.pairs} pairs were left out, no pose is known at their time")
    if report.uncertain > report.used:
        share = 100 * report.uncertain / (report.uncertain + report.used)
        texts.append(f"{share:.0f} % of the pixels are too uncertain for voxels of {voxel_m:g} m: set larger voxels")
    if report.apart > _APART:
        texts.append(
            f"the images do not fit each other: their surfaces differ by {report.apart:.2f} widths of the truncation "
            f"band, {_APART:g} is the limit: the poses are those of another frame, of other times, or not exact enough"
        )
    if report.origin_m.any():
        x, y, z = report.origin_m
        texts.append(
            f"the poses are far from their origin: all coordinates are relative to ({x:.0f}, {y:.0f}, {z:.0f}) m"
        )
    return texts

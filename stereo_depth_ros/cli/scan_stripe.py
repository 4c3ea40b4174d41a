# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth scan --kind stripe`: points of a light stripe that moves over an object."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.active.light_stripe.light_plane import LightPlane
from stereo_depth_ros.active.light_stripe.motion import StripeMotion, parse_axis
from stereo_depth_ros.active.light_stripe.motion_table import MotionTable, read_motion_table
from stereo_depth_ros.active.light_stripe.plane_file import read_plane
from stereo_depth_ros.active.light_stripe.scanner import StereoStripeScanner, StripeScanner
from stereo_depth_ros.active.light_stripe.turntable_file import read_turntable
from stereo_depth_ros.bags.sources import bag_files, is_bag
from stereo_depth_ros.bags.writer import check_bag_output
from stereo_depth_ros.calibration.view_finder import first_of
from stereo_depth_ros.cli.calibrate_laser import stripe_config
from stereo_depth_ros.cli.given import require_png
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.output import progress_bar, show, warn
from stereo_depth_ros.cli.tables import TextTable, facts_table
from stereo_depth_ros.config import LightStripeConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.datasets.image_files import read_pair
from stereo_depth_ros.datasets.image_pairs import find_image_pairs
from stereo_depth_ros.datasets.numbered_images import numbered_images, read_plain_frame
from stereo_depth_ros.datasets.rig_files import read_rig, rig_files
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.offline.pairs import read_pairs
from stereo_depth_ros.offline.stripe_scan import (
    Capture,
    StripeScan,
    bag_images,
    bag_motion,
    folder_images,
    folder_pairs,
    scan_stripes,
    with_motion,
)
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.stripe_scan import stripe_scan_plot
from stereo_depth_ros.surfaces.writing import POINT_ENDS, WrittenFile, check_ending, write_points

__all__ = ["MOVING", "StripeScanOptions", "scan_stripe"]

MOVING = ("object", "sensor", "plane")


@dataclass(frozen=True)
class StripeScanOptions:
    """Options of `stereo-depth scan --kind stripe`, as they are given.

    Attributes:
        place: bag, or folder of images.
        output: bag of the clouds.
        laser: file of the light plane.
        camera_info: calibration files of two cameras.
        left, right, side_by_side: image topics or patterns; ``left`` alone is the topic of one camera.
        motion: table of the motion.
        motion_topic: topic of a bag with JointState or PoseStamped.
        joint: name of its joint.
        step: motion between two images, mm or degrees.
        turntable: file of the axis.
        linear_axis: direction of a linear motion.
        moving: "object", "sensor" or "plane".
        ambient: image without the stripe.
        param: parameters of the stage light_stripe.
        export, preview: further files.
        json_file, overwrite: as of all commands.
    """

    place: Path
    output: Path
    laser: Path | None = None
    camera_info: tuple[Path, ...] = ()
    left: str | None = None
    right: str | None = None
    side_by_side: bool = False
    motion: Path | None = None
    motion_topic: str | None = None
    joint: str = ""
    step: float | None = None
    turntable: Path | None = None
    linear_axis: str | None = None
    moving: str = "object"
    ambient: Path | None = None
    param: tuple[str, ...] = ()
    export: Path | None = None
    preview: Path | None = None
    json_file: Path | None = None
    overwrite: bool = False


def scan_stripe(options: StripeScanOptions) -> None:
    """Scan the images, write the bag, the file of points and the preview, and print what was found.

    Raises:
        StereoDepthError: options that contradict each other, files that cannot be read or written, nothing found.
    """
    o, config = options, stripe_config([*options.param])
    of_bag = _is_bag(o.place)
    _check(o, of_bag)
    require_png("--preview", o.preview)
    inputs = [path for path in (o.laser, o.motion, o.turntable, o.ambient, *o.camera_info) if path is not None]
    inputs += bag_files(o.place) if of_bag else []
    if o.export is not None:
        check_ending(o.export, POINT_ENDS)
    further = [path for path in (o.export, o.preview) if path is not None]
    check_bag_output(o.output, inputs, reports=[o.json_file], overwrite=o.overwrite)
    check_outputs(further, inputs, overwrite=o.overwrite)
    table, pose_frame = _table(o)
    motion = _motion(o, table)
    plane = None if o.laser is None else read_plane(o.laser)
    prepare_kernels()
    scanner, captures, count = _source(o, of_bag, config, motion, plane)
    step = None if o.step is None else (np.radians(o.step) if motion.kind == "turntable" else 1e-3 * o.step)

    def value_of(name: str, stamp_ns: int, number: int) -> F64 | None:
        return with_motion(name, stamp_ns, table, step, number)

    with progress_bar("scanning") as progress:
        result = scan_stripes(
            captures,
            scanner,
            value_of,
            o.output,
            pose_frame=pose_frame,
            overwrite=o.overwrite,
            progress=lambda done: progress(done, max(count, done)),
        )
    points_m, level, sigma_m = result.cloud.points()
    files: list[WrittenFile] = []
    if o.export is not None:
        values = {"intensity": level, "sigma": sigma_m}
        files.append(write_points(o.export, points_m, values, overwrite=o.overwrite))
    if o.preview is not None and result.first is not None:
        title = f"{o.place.name}: {len(points_m)} points of {result.profiles} images"
        image = stripe_scan_plot(*result.first, points_m, level, title)
        save_png(o.preview, image, overwrite=o.overwrite)
    found = _values(result, o) | ({"surfaces": [file.to_json() for file in files]} if files else {})
    show(_tables(result, o), found, o.json_file, overwrite=o.overwrite)
    for text in first_of(result.skipped):
        warn(text)
    if result.without_motion:
        warn(f"{result.without_motion} images were left out, the motion is not known at their time")


def _is_bag(place: Path) -> bool:
    return place.is_file() or is_bag(place)


def _check(o: StripeScanOptions, of_bag: bool) -> None:
    """Refuse options that are missing or contradict each other.

    Raises:
        ConfigError: such options.
    """
    if o.laser is None and not o.camera_info:
        raise ConfigError(
            "neither --laser nor --camera-info is given: one camera needs the light plane, two need their calibration",
            remedy="give --laser laser.yaml, which `stereo-depth calibrate-laser` writes, or --camera-info LEFT RIGHT",
        )
    sources = {"--motion": o.motion, "--motion-topic": o.motion_topic, "--step": o.step}
    given = [name for name, value in sources.items() if value is not None]
    if len(given) > 1:
        raise ConfigError(f"{' and '.join(given)} contradict each other", value=given, remedy="give one of them")
    if o.turntable is not None and o.linear_axis is not None:
        raise ConfigError("--turntable and --linear-axis contradict each other", remedy="give one of them")
    if o.motion_topic is not None and not of_bag:
        raise ConfigError("--motion-topic has no effect with a folder", remedy="give --motion or --step")
    axis = o.turntable is not None or o.linear_axis is not None
    if axis and not given:
        raise ConfigError(
            "the axis of a motion is given, but not the motion", remedy="give --step, --motion or --motion-topic"
        )
    if o.step is not None and not axis:
        raise ConfigError("--step needs an axis", remedy="give --turntable turntable.yaml or --linear-axis '1 0 0'")


def _table(o: StripeScanOptions) -> tuple[MotionTable | None, str]:
    """The motion of a table or a topic, and the frame of its poses."""
    if o.motion is not None:
        return read_motion_table(o.motion), ""
    if o.motion_topic is None:
        return None, ""
    kind, track, frame_id = bag_motion(o.place, o.motion_topic, o.joint)
    of_joint = "turntable" if o.turntable is not None else "linear"
    return MotionTable("pose" if kind == "pose" else of_joint, track=track), frame_id


def _motion(o: StripeScanOptions, table: MotionTable | None) -> StripeMotion:
    kind = table.kind if table is not None else "turntable" if o.turntable is not None else "linear"
    if table is None and o.step is None:
        return StripeMotion()
    needed = {"turntable": (o.turntable, "--turntable"), "linear": (o.linear_axis, "--linear-axis")}
    if kind in needed and needed[kind][0] is None:
        raise ConfigError(
            f"the motion is {'an angle' if kind == 'turntable' else 'a position'}, and its axis is not given",
            remedy=f"add {needed[kind][1]}",
        )
    return StripeMotion(
        kind,
        o.moving,
        parse_axis(o.linear_axis) if kind == "linear" and o.linear_axis is not None else None,
        read_turntable(o.turntable) if kind == "turntable" and o.turntable is not None else None,
    )


def _source(
    o: StripeScanOptions,
    of_bag: bool,
    config: LightStripeConfig,
    motion: StripeMotion,
    laser: tuple[LightPlane, CameraModel] | None,
) -> tuple[StripeScanner | StereoStripeScanner, Iterable[Capture], int]:
    """The scanner, the captures and their number, 0 where that is not known."""
    if not o.camera_info:
        ambient = None if o.ambient is None else read_plain_frame(o.ambient)
        assert laser is not None  # checked before
        scanner = StripeScanner(*laser, config, motion, ambient)
        if of_bag:
            return scanner, bag_images(o.place, o.left), 0
        paths = numbered_images([o.place])
        return scanner, folder_images(paths), len(paths)
    plane: LightPlane | None = None if laser is None else laser[0]
    rig_files(o.camera_info)
    if of_bag:
        rig = read_rig(o.camera_info)
        pairs = read_pairs(o.place, o.left, o.right, side_by_side=o.side_by_side, camera_files=o.camera_info)
        captures = ((f"{pair.left.stamp_ns / 1e9:.3f} s", _of(pair)) for pair, _ in pairs)
        return StereoStripeScanner(rig, config, motion, plane), captures, 0
    found = find_image_pairs(o.place, o.left, o.right, side_by_side=o.side_by_side)
    height, width = read_pair(*found.pairs[0])[0].shape[:2]
    rig = read_rig(o.camera_info, size=(width, height))
    listed = folder_pairs(o.place, rig, o.left, o.right, side_by_side=o.side_by_side)
    return StereoStripeScanner(rig, config, motion, plane), listed, len(listed)


def _of(pair: Any) -> Callable[[], Any]:
    return lambda: pair


def _values(result: StripeScan, o: StripeScanOptions) -> dict[str, Any]:
    points_m, _, sigma_m = result.cloud.points()
    return {
        "images": len(result.cloud),
        "profiles": result.profiles,
        "points": len(points_m),
        "reasons": dict(result.reasons),
        "sigma_median_m": float(np.median(sigma_m)),
        "low_m": points_m.min(axis=0).tolist(),
        "high_m": points_m.max(axis=0).tolist(),
        "without_motion": result.without_motion,
        "skipped": result.skipped,
        "output": str(o.output),
    }


def _tables(result: StripeScan, o: StripeScanOptions) -> Iterator[TextTable]:
    points_m, _, sigma_m = result.cloud.points()
    low, high = np.percentile(points_m, [0.5, 99.5], axis=0)
    facts = facts_table()
    facts.add_row("images", f"{len(result.cloud)} scanned, {result.profiles} with points")
    lines = sum(result.reasons.values())
    facts.add_row("points", f"{len(points_m)} of {lines} lines")
    counts = sorted(
        ((count, name) for name, count in result.reasons.items() if count and name != "POINTS"), reverse=True
    )
    facts.add_row("without", ", ".join(f"{name.lower().replace('_', ' ')} {count}" for count, name in counts) or "none")
    facts.add_row("size", " x ".join(f"{1e3 * extent:.1f}" for extent in high - low) + " mm, 99 % of the points")
    facts.add_row("standard deviation", f"median {1e3 * float(np.median(sigma_m)):.3f} mm, by the noise of the images")
    for name, path in (("bag", o.output), ("points file", o.export), ("preview", o.preview)):
        if path is not None:
            facts.add_row(name, str(path))
    yield facts

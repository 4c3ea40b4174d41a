# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Depth from focus without a ROS graph: the images of a stack from a folder or a bag, and a bag of the results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stereo_depth_ros.active.focus.stack import FocusResult
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.sources import bag_files, is_bag
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config import CloudConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import BagError, ConfigError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, Frame
from stereo_depth_ros.datasets.numbered_images import numbered_images, read_plain_frame
from stereo_depth_ros.messages.camera_info import rectified_camera_info
from stereo_depth_ros.messages.depth import depth_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.point_cloud import cloud_message
from stereo_depth_ros.offline.stripe_scan import bag_images
from stereo_depth_ros.stages.point_cloud import CloudLayout
from stereo_depth_ros.surfaces.range_image import RangeImage

__all__ = ["FocusImages", "range_image", "read_focus_images", "write_focus_bag"]

_INTERVAL_NS = 100_000_000  # between the images of a folder, which have no stamps


@dataclass(frozen=True)
class FocusImages:
    """The images of a stack, in the order of their numbers or of their stamps.

    Attributes:
        frames: the images.
        names: of their files, or of their stamps.
        of_bag: whether they have stamps and no files.
        files: that were read.
    """

    frames: list[Frame]
    names: list[str]
    of_bag: bool
    files: list[Path]


def read_focus_images(place: Path, topic: str | None = None, *, ordered: bool = False) -> FocusImages:
    """The images of a folder or of a topic of a bag.

    Args:
        place: the folder or the bag.
        topic: of the images in the bag; None takes the only one.
        ordered: their order is known otherwise, such as from a table.

    Raises:
        BagError, TopicError, MessageError: no images, or one that cannot be read.
        ConfigError: files whose names have no numbers, so that their order is not known.
    """
    if is_bag(place):
        captured = [(name, read()) for name, read in bag_images(place, topic, "topic")]
        captured.sort(key=lambda each: each[1].stamp_ns)
        return FocusImages([frame for _, frame in captured], [name for name, _ in captured], True, bag_files(place))
    if place.is_file():
        raise BagError(
            "is neither a bag nor a folder of images", subject=str(place), remedy="name the folder of the images"
        )
    paths = numbered_images([place])
    unnumbered = [path.name for path in paths if not any(letter.isdigit() for letter in path.stem)]
    if unnumbered and len(paths) > 1 and not ordered:
        raise ConfigError(
            f"the order of the images is unknown, {unnumbered[0]} has no number in its name",
            subject=str(place),
            value=unnumbered[0],
            remedy="number the files in the order of their focus, or give a table of their focus distances",
            settings=("table",),
        )
    frames = [read_plain_frame(path, number * _INTERVAL_NS) for number, path in enumerate(paths)]
    return FocusImages(frames, [path.name for path in paths], False, paths)


def write_focus_bag(
    output: Path,
    result: FocusResult,
    frame: Frame,
    camera: CameraModel | None = None,
    *,
    metadata: Mapping[str, str] | None = None,
    overwrite: bool = False,
) -> list[str]:
    """Write the results as messages of the stamp and frame of the reference image.

    focus/image_rect_color is the all-in-focus image, focus/index and focus/index_sigma are 32FC1, focus/reasons is
    mono8. With focus distances also depth/image_rect (32FC1, meters) and depth/sigma; with a camera depth/camera_info
    and points2.

    Args:
        output: the bag, ``.mcap``.
        result: of the stack; rectified where there is a camera.
        frame: the reference image.
        camera: its calibration; None where it is not known.
        metadata: names and values that are written into the bag.
        overwrite: replace a file that is there.

    Returns:
        The topics.

    Raises:
        OutputError: the bag cannot be written.
    """
    types = RosbagsTypes()
    stamp_ns, frame_id = frame.stamp_ns, frame.frame_id
    header = stamp_ns, frame_id
    messages = {
        "/focus/image_rect_color": image_message(types, result.all_in_focus, result.encoding, *header),
        "/focus/index": image_message(types, result.index, "32FC1", *header),
        "/focus/index_sigma": image_message(types, result.index_sigma, "32FC1", *header),
        "/focus/reasons": image_message(types, result.reasons, "mono8", *header),
    }
    if result.depth_m is not None and result.sigma_m is not None:
        pool = PayloadPool(types)
        messages["/depth/image_rect"] = depth_message(types, pool, result.depth_m, "32FC1", *header)
        messages["/depth/sigma"] = image_message(types, result.sigma_m, "32FC1", *header)
        if camera is not None:
            messages["/depth/camera_info"] = rectified_camera_info(types, camera, *header)
            layout = CloudLayout.of(CloudConfig())
            messages["/points2"] = cloud_message(
                types,
                *_as_disparity(result.depth_m, camera),
                layout,
                stamp_ns=stamp_ns,
                frame_id=frame_id,
                color=result.all_in_focus,
                color_encoding=result.encoding,
            )
    with BagWriter(output, overwrite=overwrite) as bag:
        bag.write_metadata("stereo_depth_ros", metadata or {})
        for topic, message in messages.items():
            bag.write(topic, message, stamp_ns)
    return [*messages]


def range_image(result: FocusResult, camera: CameraModel) -> RangeImage:
    """The depth of a stack, rectified, with its standard deviations and the all-in-focus image.

    Raises:
        ConfigError: its focus distances are not known, so that it has no depth.
    """
    if result.depth_m is None or result.sigma_m is None:
        raise ConfigError(
            "the focus distances are unknown, without them there is no depth",
            remedy="give the focus distance of each image",
            settings=("table", "near", "far"),
        )
    color = result.all_in_focus[:, :, ::-1] if result.encoding == "bgr8" else result.all_in_focus
    return RangeImage(result.depth_m, result.sigma_m, _geometry(camera, 0.0), color)


def _geometry(camera: CameraModel, baseline_m: float) -> Triangulation:
    (fx, _, cx), (_, fy, cy) = camera.P[:2, :3].tolist()
    return Triangulation(fx, fy, cx, cy, baseline_m, 0.0)


def _as_disparity(depth_m: F32, camera: CameraModel) -> tuple[F32, Triangulation]:
    """The depth as the disparity of a baseline of one meter, of which clouds are made."""
    geometry = _geometry(camera, 1.0)
    return np.float32(geometry.f_px) / depth_m, geometry

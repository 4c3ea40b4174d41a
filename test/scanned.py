# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Captures of patterns for the tests of scans: of two cameras, or of one camera and the projector."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.active.projector.rectification import rectify_camera_and_projector
from stereo_depth_ros.active.scanner import Capture
from stereo_depth_ros.active.structured_light.manifest import manifest_text
from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, U8, Frame
from stereo_depth_ros.geometry.relative_pose import RelativePose
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.synthetic.projection import SyntheticScanner

SIZE, PROJECTOR = (160, 120), (128, 96)
FIRST_NS, STEP_NS = 10**12, 10**8
SEQUENCE = PatternSequence.of_kind("gray+phase", PROJECTOR)


@functools.cache
def scanner() -> SyntheticScanner:
    return SyntheticScanner(*SIZE, PROJECTOR)


@functools.cache
def pictured() -> tuple[tuple[U8, U8], ...]:
    """Left and right image of each pattern."""
    return tuple(scanner().capture(pattern) for pattern in SEQUENCE.render())


@functools.cache
def projector_rig() -> StereoRig:
    """The left camera and the projector."""
    own = scanner()
    pose = RelativePose(own.R_projector_left, own.T_projector_left)
    return rectify_camera_and_projector(own.rig.left, own.projector, pose)


def stamp_ns(number: int) -> int:
    """Stamp of the capture with this number."""
    return FIRST_NS + number * STEP_NS


def captures() -> list[Capture]:
    """One of each pattern, with stamps."""
    rig = scanner().rig
    return [
        (Frame(left, stamp_ns(n), rig.left.frame_id), Frame(right, stamp_ns(n), rig.right.frame_id))
        for n, (left, right) in enumerate(pictured())
    ]


def messages(types: Any, images: tuple[U8, ...], number: int, bits: int = 8) -> dict[str, Any]:
    """Images by topic; one image is that of the left camera. More than 8 bits are in mono16."""
    rig = scanner().rig
    sides = zip(("left", "right"), (rig.left, rig.right), images, strict=False)
    found = {}
    for side, camera, image in sides:
        pixels = image if bits == 8 else image.astype(np.uint16) << (bits - 8)
        encoding = "mono8" if bits == 8 else "mono16"
        found[f"{side}/image_raw"] = image_message(types, pixels, encoding, stamp_ns(number), camera.frame_id)
    return found


def infos(types: Any, rig: StereoRig, number: int) -> dict[str, Any]:
    """Camera infos by topic."""
    sides = (("left", rig.left), ("right", rig.right))
    return {f"{side}/camera_info": camera_info_message(types, camera, stamp_ns(number)) for side, camera in sides}


def write_manifest(folder: Path, sequence: PatternSequence = SEQUENCE) -> Path:
    """The manifest of the patterns in a folder."""
    path = folder / "patterns.json"
    path.write_text(manifest_text(sequence), "utf-8")
    return path


def write_bag(path: Path, shown: list[int], shows: dict[int, int] | None = None, bits: int = 8) -> Path:
    """A bag of captures, each of the pattern ``shown``; before those of ``shows`` that number is announced."""
    types = RosbagsTypes()
    with BagWriter(path) as bag:
        for number, pattern in enumerate(shown):
            at_ns = stamp_ns(number)
            if shows and number in shows:
                number_type = types.typestore.types["std_msgs/msg/Int32"]
                bag.write("/scan/shown", number_type(data=shows[number]), at_ns - STEP_NS // 2)
            for topic, message in (*infos(types, scanner().rig, number).items(),):
                bag.write(f"/{topic}", message, at_ns)
            for topic, message in messages(types, pictured()[pattern], number, bits).items():
                bag.write(f"/{topic}", message, at_ns)
    return path


def errors(disparity_px: F32) -> F32:
    """Absolute errors of disparities of both cameras, float32 (N,), px."""
    found = np.isfinite(disparity_px)
    difference: F32 = np.abs(disparity_px - scanner().truth().disparity_px)[found]
    return difference

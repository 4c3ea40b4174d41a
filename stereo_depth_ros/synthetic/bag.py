# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes synthetic sequences and scans as bags: raw images, camera infos and the true disparities."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import F32, U8, Frame
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.disparity import disparity_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.synthetic.projection import SyntheticScanner
from stereo_depth_ros.synthetic.sequence import START_NS, SyntheticSequence

__all__ = ["TRUTH_STEP_PX", "write_scan_bag", "write_synthetic_bag"]

_BETWEEN_NS = 10**8  # captures of a scan
TRUTH_STEP_PX = 1 / 256  # unrounded float32 compresses eight times worse


def write_synthetic_bag(
    path: Path,
    sequence: SyntheticSequence,
    *,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Write all frames of ``sequence``; equal sequences give equal files.

    Topics: ``image_raw`` and ``camera_info`` in ``/left`` and ``/right``, and ``/truth/disparity``, a
    stereo_msgs/DisparityImage of the rectified left image, rounded to 1/256 px, with the surfaces that are occluded in
    the right image.

    Args:
        path: file to create, must end in ``.mcap``.
        sequence: the sequence to write.
        overwrite: replace an existing file.
        progress: called after each frame with the frames written and all frames.

    Raises:
        BagError: wrong suffix.
        OutputError: an existing file without ``overwrite``, or it cannot be written.
    """
    types = RosbagsTypes()
    with BagWriter(path, overwrite=overwrite) as bag:
        for number, frame in enumerate(sequence, start=1):
            _write_pair(bag, types, (frame.pair.left, frame.pair.right), sequence.rig)
            _write_truth(bag, types, frame.truth_disparity_px, sequence.rig, frame.pair.left.stamp_ns)
            progress(number, len(sequence))


def write_scan_bag(
    path: Path,
    scanner: SyntheticScanner,
    patterns: Sequence[U8],
    *,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Write one capture of each pattern; the topics are those of :func:`write_synthetic_bag`.

    Args:
        path: file to create, must end in ``.mcap``.
        scanner: the cameras, the projector and the scene.
        patterns: uint8 (h, w) or (h, w, 3) RGB, of the size of the projector.
        overwrite: replace an existing file.
        progress: called after each capture with the captures written and all captures.

    Raises:
        BagError: wrong suffix.
        ConfigError: a pattern of another size.
        OutputError: an existing file without ``overwrite``, or it cannot be written.
    """
    types, rig = RosbagsTypes(), scanner.rig
    cameras = (rig.left, rig.right)
    with BagWriter(path, overwrite=overwrite) as bag:
        truth_px = scanner.truth().disparity_px
        for number, pattern in enumerate(patterns):
            stamp_ns, encoding = START_NS + number * _BETWEEN_NS, "mono8" if pattern.ndim == 2 else "rgb8"
            images = zip(scanner.capture(pattern), cameras, strict=True)
            left, right = (Frame(image, stamp_ns, camera.frame_id, encoding) for image, camera in images)
            _write_pair(bag, types, (left, right), rig)
            _write_truth(bag, types, truth_px, rig, stamp_ns)
            progress(number + 1, len(patterns))


def _write_pair(bag: BagWriter, types: RosbagsTypes, frames: tuple[Frame, Frame], rig: StereoRig) -> None:
    for name, frame, camera in zip(("/left", "/right"), frames, (rig.left, rig.right), strict=True):
        bag.write(f"{name}/camera_info", camera_info_message(types, camera, frame.stamp_ns), frame.stamp_ns)
        image = image_message(types, frame.pixels, frame.encoding, frame.stamp_ns, frame.frame_id)
        bag.write(f"{name}/image_raw", image, frame.stamp_ns)


def _write_truth(bag: BagWriter, types: RosbagsTypes, truth_px: F32, rig: StereoRig, stamp_ns: int) -> None:
    disparity_px = np.round(truth_px / np.float32(TRUTH_STEP_PX)) * np.float32(TRUTH_STEP_PX)
    truth = disparity_message(
        types,
        disparity_px,
        rig,
        min_disparity=rig.doffs_px,  # at infinity
        max_disparity=float(np.fmax.reduce(disparity_px, axis=None, initial=rig.doffs_px)),
        step_px=TRUTH_STEP_PX,
        stamp_ns=stamp_ns,
        frame_id=rig.frame_id,
    )
    bag.write("/truth/disparity", truth, stamp_ns)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes a synthetic sequence as a bag: raw images, camera infos and the true disparities."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.disparity import disparity_message
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.synthetic.sequence import SyntheticFrame, SyntheticSequence

__all__ = ["TRUTH_STEP_PX", "write_synthetic_bag"]

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
            _write_frame(bag, types, frame, sequence.rig)
            progress(number, len(sequence))


def _write_frame(bag: BagWriter, types: RosbagsTypes, frame: SyntheticFrame, rig: StereoRig) -> None:
    stamp_ns = frame.pair.left.stamp_ns
    sides = (("/left", frame.pair.left, rig.left), ("/right", frame.pair.right, rig.right))
    for name, side, camera in sides:
        bag.write(f"{name}/camera_info", camera_info_message(types, camera, stamp_ns), stamp_ns)
        image = image_message(types, side.pixels, side.encoding, stamp_ns, side.frame_id)
        bag.write(f"{name}/image_raw", image, stamp_ns)
    disparity_px = np.round(frame.truth_disparity_px / np.float32(TRUTH_STEP_PX)) * np.float32(TRUTH_STEP_PX)
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

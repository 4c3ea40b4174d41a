# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pairs of a bag with their rigs, for Python programs."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, PerCalibration
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.diagnosis.stereo_choice import choose_topics

__all__ = ["read_pairs"]


def read_pairs(
    bag: str | Path,
    left: str | None = None,
    right: str | None = None,
    *,
    side_by_side: bool = False,
    camera_files: Sequence[str | Path] = (),
) -> Iterator[tuple[StereoPair, StereoRig]]:
    """The pairs of a bag in the order of their stamps, each with its rig; the same rig until a camera info changes.

    Topics are found as by ``stereo-depth process``; where not the best by name are used, a Python warning says so.

    Args:
        bag: MCAP or .db3 file, rosbag2 folder or ROS 1 bag.
        left, right: image topics; None finds them.
        side_by_side: both images are in one topic, ``left`` or ``right``, the left one in the left half.
        camera_files: calibration files that are read instead of its camera infos.

    Raises:
        BagError, TopicError: no readable stereo bag.
        MessageError, CalibrationError: an image or a camera info that cannot be used.
    """
    types, pairing = RosbagsTypes(), PairingConfig()
    rigs, depth = PerCalibration(types, lambda rig: rig), BitDepth()
    files = tuple(map(Path, camera_files))
    selection = BagSelection(Path(bag), left, right, side_by_side=side_by_side, camera_files=files)
    selection, note = choose_topics(selection, pairing)
    if note:
        warnings.warn(note, stacklevel=2)
    with BagPairs(selection, pairing) as pairs:
        for pair in pairs.pairs():
            image_type = pairs.topics.image_type
            rig = rigs.of(pair, image_type)
            yield pair.images(types, image_type, rig, depth), rig

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a light stripe scan, the same live and offline: the cloud of a profile, and the merged cloud."""

from __future__ import annotations

from typing import Any

import numpy as np

from stereo_depth_ros.active.light_stripe.scanner import MergedCloud, ScannedProfile
from stereo_depth_ros.messages.point_cloud import valued_cloud_message
from stereo_depth_ros.messages.types import MessageTypes

__all__ = ["MERGED_TOPIC", "PROFILE_TOPIC", "merged_message", "profile_message"]

PROFILE_TOPIC, MERGED_TOPIC = "stripe/points2", "stripe/merged"


def profile_message(types: MessageTypes, profile: ScannedProfile) -> Any:
    """The points of a profile in the frame of its image: x, y, z, intensity (gray levels) and sigma (meters)."""
    found = profile.found
    values = {"intensity": found.level.astype(np.float32), "sigma": found.sigma_m.astype(np.float32)}
    stamp_ns, frame_id = profile.stamp_ns, profile.frame_id
    return valued_cloud_message(types, found.points_m, values, stamp_ns=stamp_ns, frame_id=frame_id)


def merged_message(types: MessageTypes, cloud: MergedCloud, stamp_ns: int, frame_id: str) -> Any:
    """The points of all profiles in one frame, with the fields of :func:`profile_message`."""
    points_m, level, sigma_m = cloud.points()
    values = {"intensity": level, "sigma": sigma_m}
    return valued_cloud_message(types, points_m, values, stamp_ns=stamp_ns, frame_id=frame_id)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""REP 118 depth images."""

from __future__ import annotations

from typing import Any

from stereo_depth_ros.core.types import F32
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.types import MessageTypes
from stereo_depth_ros.stages.depth import millimeters

__all__ = ["depth_message"]


def depth_message(
    types: MessageTypes, pool: PayloadPool, depth_m: F32, encoding: str, stamp_ns: int, frame_id: str
) -> Any:
    """A REP 118 depth image of float32 (H, W) meters: 32FC1 with NaN, or 16UC1 millimeters with 0."""
    pixels = depth_m if encoding == "32FC1" else millimeters(depth_m)
    payload = pool.get("depth", pixels.nbytes)
    return image_message(types, pixels, encoding, stamp_ns, frame_id, payload)

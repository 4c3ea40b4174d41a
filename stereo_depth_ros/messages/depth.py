# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""REP 118 depth images, and other images of float32."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.types import F32
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.types import MessageTypes
from stereo_depth_ros.stages.depth import millimeters

__all__ = ["depth_message", "depth_pixels", "float_pixels"]

_DEPTH_ENCODINGS = {"16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3), "32FC1": ("f4", 1.0)}  # type, meters of a level


def depth_message(
    types: MessageTypes, pool: PayloadPool, depth_m: F32, encoding: str, stamp_ns: int, frame_id: str
) -> Any:
    """A REP 118 depth image of float32 (H, W) meters: 32FC1 with NaN, or 16UC1 millimeters with 0."""
    pixels = depth_m if encoding == "32FC1" else millimeters(depth_m)
    payload = pool.get("depth", pixels.nbytes)
    return image_message(types, pixels, encoding, stamp_ns, frame_id, payload)


def depth_pixels(msg: Any, topic: str = "") -> F32:
    """The depth of a sensor_msgs/Image by REP 118, float32 (H, W), meters; NaN where it is 0, not finite or below 0.

    Raises:
        MessageError: another encoding than 16UC1 and mono16 in millimeters or 32FC1 in meters, or too few bytes.
    """
    if msg.encoding not in _DEPTH_ENCODINGS:
        raise MessageError(
            f"encoding {quoted(msg.encoding)}, a depth image is one of {', '.join(_DEPTH_ENCODINGS)}",
            subject=topic,
            value=msg.encoding,
            limit=tuple(_DEPTH_ENCODINGS),
            remedy="use the raw depth topic",
        )
    kind, meters = _DEPTH_ENCODINGS[msg.encoding]
    with np.errstate(invalid="ignore"):
        depth_m = _levels(msg, topic, kind).astype(np.float32) * np.float32(meters)
        depth_m[~((depth_m > 0) & np.isfinite(depth_m))] = np.nan
    return depth_m


def float_pixels(msg: Any, topic: str = "") -> F32:
    """The pixels of a sensor_msgs/Image of float32, (H, W).

    Raises:
        MessageError: another encoding than 32FC1, or too few bytes.
    """
    if msg.encoding != "32FC1":
        raise MessageError(
            f"encoding {quoted(msg.encoding)}, 32FC1 is expected",
            subject=topic,
            value=msg.encoding,
            limit="32FC1",
            remedy="remap it to the topic of disparity_node",
        )
    return np.asarray(_levels(msg, topic, "f4"), np.float32)


def _levels(msg: Any, topic: str, kind: str) -> npt.NDArray[Any]:
    """The pixels of a message of one channel, of a dtype without its byte order."""
    dtype = np.dtype((">" if msg.is_bigendian else "<") + kind)
    size, needed = len(msg.data), msg.step * msg.height
    if msg.width == 0 or msg.height == 0 or msg.step < dtype.itemsize * msg.width or size < needed:
        raise MessageError(
            f"data has {size} bytes and rows of {msg.step}, {msg.width}x{msg.height} px of {msg.encoding} are expected",
            subject=topic,
            value=size,
            limit=needed,
            remedy="the payload is truncated, or width, height or step is wrong",
        )
    rows = np.frombuffer(msg.data, np.uint8, needed).reshape(msg.height, msg.step)
    return np.ascontiguousarray(rows[:, : dtype.itemsize * msg.width]).view(dtype)

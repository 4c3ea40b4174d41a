# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images that hold the left and the right image side by side, split into two messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.messages.encodings import ENCODINGS
from stereo_depth_ros.messages.image import image_size, uncompressed_message
from stereo_depth_ros.messages.types import MessageTypes, make_header, stamp_ns

__all__ = ["WIDE", "split_message"]

WIDE = 2.4  # width over height of two images side by side; those of one camera have up to 2.39 (cinema), rarely more


def split_message(
    types: MessageTypes, msg: Any, topic: str = "", frames: tuple[str, str] = ("", "")
) -> tuple[Any, Any]:
    """The left and the right half of an image, each a sensor_msgs/Image in the encoding of the whole.

    Args:
        types: the family of messages.
        msg: a sensor_msgs/Image or sensor_msgs/CompressedImage, of any family; the left image in its left half.
        topic: its topic, for error messages.
        frames: frame_id of the left and the right image.

    Raises:
        MessageError: a damaged image, or a width that has no half: twice as many pixels as the blocks of the encoding.
    """
    image = msg if hasattr(msg, "encoding") else uncompressed_message(types, msg, topic)
    width, height = image_size(image, topic)
    encoding = ENCODINGS[image.encoding]
    # half a mosaic begins with the same color as the whole
    multiple = 2 * (2 if image.encoding.startswith("bayer_") else encoding.multiple[1])
    if width % multiple:
        raise MessageError(
            f"an image of {width}x{height} {image.encoding} has no two halves, a multiple of {multiple} px has",
            subject=f"image of {topic}" if topic else "image",
            value=width,
            limit=multiple,
            remedy="side by side are two images of equal widths",
        )
    rows = np.frombuffer(image.data, np.uint8).reshape(-1, image.step)
    step = width // 2 * encoding.samples * encoding.sample_bytes
    halves = rows[:, :step], rows[:, step : 2 * step]
    left, right = (_half(types, image, half, frame) for half, frame in zip(halves, frames, strict=True))
    return left, right


def _half(types: MessageTypes, image: Any, rows: Any, frame_id: str) -> Any:
    data, view = types.payload(rows.size)
    view[:] = rows.ravel()
    return types.Image(
        header=make_header(types, stamp_ns(image.header), frame_id),
        height=image.height,
        width=image.width // 2,
        encoding=image.encoding,
        is_bigendian=image.is_bigendian,
        step=rows.shape[1],
        data=data,
    )

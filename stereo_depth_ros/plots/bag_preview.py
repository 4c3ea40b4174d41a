# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The preview of a bag of outputs: its first left image beside the depth of the same stamp."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, U8
from stereo_depth_ros.messages.disparity import published_disparity
from stereo_depth_ros.messages.image import decode
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.plots.preview import save_preview
from stereo_depth_ros.stages.depth import depth_from_disparity

__all__ = ["save_bag_preview"]

_LEFT, _DISPARITY = "/left/image_rect_color", "/disparity"


def save_bag_preview(bag: Path, image: Path, title: str = "", *, overwrite: bool = False) -> None:
    """Write the preview of the first pair of a bag of outputs as a PNG.

    Raises:
        BagError: the bag lacks a rectified left image with a disparity of the same stamp.
        OutputError: the image is there and ``overwrite`` is false, or it cannot be written.
    """
    left, depth_m = _first_pair(bag)
    save_preview(image, left, depth_m, title, overwrite=overwrite)


def _first_pair(bag: Path) -> tuple[U8, F32]:
    """The left image, gray or BGR, and the depth float32 (H, W), meters, NaN where invalid."""
    images: dict[int, Any] = {}
    disparities: dict[int, Any] = {}
    with BagReader(bag) as reader:
        if {_LEFT, _DISPARITY} <= set(reader.topics):
            for message in reader.messages([_LEFT, _DISPARITY]):
                decoded = reader.deserialize(message)
                stamp = stamp_ns(decoded.header)
                (images if message.topic == _LEFT else disparities)[stamp] = decoded
                if stamp in images and stamp in disparities:
                    frame, disparity = decode(images[stamp], _LEFT), disparities[stamp]
                    disparity_px = published_disparity(disparity, _DISPARITY)
                    pixels = frame.pixels[..., ::-1] if frame.encoding == "rgb8" else frame.pixels
                    return np.ascontiguousarray(pixels), depth_from_disparity(disparity_px, _published(disparity))
    raise BagError(
        f"no {_LEFT} with a {_DISPARITY} of the same stamp",
        subject=str(bag),
        remedy="use a bag with these outputs",
    )


def _published(message: Any) -> Triangulation:
    """Z = f T / d, as for every published disparity; X and Y are not used."""
    return Triangulation(message.f, message.f, 0.0, 0.0, message.t, doffs_px=0.0)

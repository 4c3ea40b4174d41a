# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of frames to gray."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import U8, Frame

__all__ = ["to_gray"]


def to_gray(frame: Frame, out: U8 | None = None) -> U8:
    """The frame as uint8 (H, W).

    Args:
        frame: mono8, or the gray of the frame where it has one, is returned as is and ``out`` is not used; color is
            weighted as in Rec. 601.
        out: uint8 (H, W), C-contiguous: written and returned if gray is computed from the colors.

    Raises:
        ImageError: ``out`` has another size, type or layout.
    """
    if frame.encoding == "mono8":
        return frame.pixels
    if frame.gray is not None:
        return frame.gray
    height, width = frame.pixels.shape[:2]
    if out is None:
        out = np.empty((height, width), np.uint8)
    elif out.shape != (height, width) or out.dtype != np.uint8 or not out.flags.c_contiguous:
        raise ImageError(
            f"buffer is {out.dtype} {out.shape} with strides {out.strides}, the frame takes contiguous uint8 "
            f"{(height, width)}",
            subject="out",
            value=(str(out.dtype), out.shape),
            limit=("uint8", (height, width)),
            remedy="allocate the buffer again when the image size changes",
        )
    cv2.cvtColor(frame.pixels, cv2.COLOR_RGB2GRAY if frame.encoding == "rgb8" else cv2.COLOR_BGR2GRAY, dst=out)
    return out

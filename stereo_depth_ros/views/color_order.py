# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images in BGR, the order in which all views are computed."""

from __future__ import annotations

import cv2
import numpy as np

from stereo_depth_ros.core.types import U8

__all__ = ["as_bgr", "bgr_pixels"]


def as_bgr(image: U8) -> U8:
    """A gray image, uint8 (H, W), in color, (H, W, 3), C-contiguous; an image in color as it is."""
    colored = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    return np.ascontiguousarray(colored, np.uint8)


def bgr_pixels(pixels: U8, encoding: str) -> U8:
    """The pixels of a mono8, rgb8 or bgr8 image: uint8 (H, W) or (H, W, 3) BGR."""
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), np.uint8) if encoding == "rgb8" else pixels

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bit depth of a stream of 16-bit images, and their scaling to 8 bits."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereo_depth_ros.core.types import U8

__all__ = ["BitDepth"]

_DEPTHS = (8, 10, 12, 14, 16)  # of sensors


class BitDepth:
    """Bits of the 16-bit samples of both cameras of a rig.

    Cameras of 10, 12 or 14 bits publish 16-bit encodings, mostly without a shift, and no field of the message has the
    depth. It is the smallest of 8, 10, 12, 14 and 16 that holds the largest sample so far, of either camera. So both
    images of a pair have one scale, and the same pairs in the same order have the same pixels. The depth only grows:
    from the first pair on that has a brighter sample than the depth holds, the images are darker by a constant factor.
    Samples in the upper bits, where some drivers shift them, have 16 bits, fewer where all are dark: no case by itself.

    Attributes:
        bits: so far; 0 before the first 16-bit image.
    """

    def __init__(self) -> None:
        self.bits = 0

    def restart(self) -> None:
        """Forget the images so far: another stream begins."""
        self.bits = 0

    def include(self, *images: NDArray[Any]) -> None:
        """Grow to hold the samples, uint16 of any shape; uint8 ones are ignored."""
        for samples in images:
            if samples.dtype == np.uint16:
                used = int(samples.max()).bit_length()
                self.bits = max(self.bits, next(bits for bits in _DEPTHS if bits >= used))

    def to_8_bit(self, samples: NDArray[Any]) -> U8:
        """uint8 of uint8 (unchanged) or included native uint16 samples: the largest number of the depth becomes 255."""
        if samples.dtype == np.uint8:
            return samples
        return np.asarray(cv2.convertScaleAbs(samples, alpha=255.0 / (2**self.bits - 1)), np.uint8)

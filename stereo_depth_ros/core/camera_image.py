# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An image in the encoding of its camera, from which gray and color are published as image_proc publishes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

__all__ = ["BILINEAR", "VARIABLE_GRADIENTS", "CameraImage"]

BILINEAR, VARIABLE_GRADIENTS = 0, 3  # values of the parameter debayer


@dataclass(frozen=True, eq=False)
class CameraImage:
    """What the camera sent, where it is more than the 8-bit pixels of a frame: 16 bits, alpha, or a mosaic.

    Attributes:
        samples: uint8 or uint16, native byte order, (H, W) gray or mosaic, or (H, W, C) color; read-only.
        encoding: of :meth:`color`, as in sensor_msgs: mono16, rgb16, rgba8, bgr8 of a mosaic, ...
        gray_code: cv2.cvtColor code from the samples to gray; None where they are gray.
        color_code, fine_color_code: codes from a mosaic to color, bilinear, and with variable gradients (VNG) where
            OpenCV has it for these samples; None where the samples are in ``encoding``.
    """

    samples: npt.NDArray[Any]
    encoding: str
    gray_code: int | None = None
    color_code: int | None = None
    fine_color_code: int | None = None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, CameraImage):
            return NotImplemented
        codes = [(i.encoding, i.gray_code, i.color_code, i.fine_color_code) for i in (self, other)]
        return codes[0] == codes[1] and np.array_equal(self.samples, other.samples)

    __hash__ = None  # type: ignore[assignment]

    def gray(self) -> npt.NDArray[Any]:
        """(H, W), with the bits of the samples."""
        return _converted(self.samples, self.gray_code)

    def color(self, debayer: int = VARIABLE_GRADIENTS) -> npt.NDArray[Any]:
        """(H, W) or (H, W, C) in ``encoding``, with the bits of the samples.

        Args:
            debayer: how a mosaic is converted, a value of the parameter of this name.
        """
        fine = debayer == VARIABLE_GRADIENTS and self.fine_color_code is not None
        return _converted(self.samples, self.fine_color_code if fine else self.color_code)


def _converted(samples: npt.NDArray[Any], code: int | None) -> npt.NDArray[Any]:
    return samples if code is None else np.asarray(cv2.cvtColor(samples, code))

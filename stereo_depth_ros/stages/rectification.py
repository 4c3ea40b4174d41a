# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectification of raw left and right images to a rectified pair."""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.rig import Rig
from stereo_depth_ros.core.types import U8, U16, Frame, RectifiedPair, StereoPair

__all__ = ["Rectifier", "gray_of_camera", "rectification_maps"]

AnyPixels = TypeVar("AnyPixels", bound=npt.NDArray[Any])


def gray_of_camera(frame: Frame) -> U8 | U16:
    """The gray that is rectified, (H, W): uint16 where the camera sent 16 bits, else uint8."""
    if frame.camera is not None and frame.camera.samples.dtype == np.uint16:
        return frame.camera.gray()
    return to_gray(frame)


class Rectifier:
    """Undistorts and rotates both images into the rectified cameras of a rig, by linear interpolation.

    The maps are built once, in 1/32 px steps. Pixels without a source are 0, see :attr:`left_source` and
    :attr:`right_source`. Images of a camera that is already rectified are passed through without a copy.

    Args:
        rig: raw cameras (K, D) and rectified ones (R, P).
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._left_maps = rectification_maps(rig.left)
        self._right_maps = rectification_maps(rig.right)

    def rectify(self, pair: StereoPair, depth: BitDepth | None = None) -> RectifiedPair:
        """Both images in gray, and the left one in color.

        Conversion to gray precedes rectification, so the gray images equal those of a rectifier of gray input. Scaling
        to 8 bits follows it, so they equal the rectified images of 16 bits that another node receives.

        Args:
            pair: raw images of the size of the rig.
            depth: of the rectified 16-bit images of the stream, grows with the pair; None is that of this pair alone.

        Raises:
            CalibrationError: an image has another size than the rig.
        """
        depth = depth or BitDepth()
        grays = self.rectify_left(gray_of_camera(pair.left)), self.rectify_right(gray_of_camera(pair.right))
        depth.include(*grays)
        left, right = (depth.to_8_bit(gray) for gray in grays)
        left_16, right_16 = (np.asarray(gray, np.uint16) if gray.dtype == np.uint16 else None for gray in grays)
        left_color = left
        if pair.left.encoding != "mono8":
            left_color = self.rectify_left(pair.left.pixels)
        return RectifiedPair(left, right, left_color, pair.left.encoding, left_16, right_16)

    def rectify_left(self, pixels: AnyPixels, out: AnyPixels | None = None) -> AnyPixels:
        """The rectified left image.

        Args:
            pixels: uint8 or uint16 (H, W) or (H, W, C), raw.
            out: same shape, written if the image needs rectification; not ``pixels`` itself.

        Raises:
            CalibrationError: the image has another size than the rig.
        """
        return self._remap(pixels, self._left_maps, out, self.rig.topics[0])

    def rectify_right(self, pixels: AnyPixels, out: AnyPixels | None = None) -> AnyPixels:
        """The rectified right image; as :meth:`rectify_left`."""
        return self._remap(pixels, self._right_maps, out, self.rig.topics[1])

    @cached_property
    def left_source(self) -> npt.NDArray[np.bool_]:
        """bool (H, W), true where the rectified left pixel is interpolated from raw pixels only."""
        return np.equal(self.rectify_left(self._white()), 255)

    @cached_property
    def right_source(self) -> npt.NDArray[np.bool_]:
        """bool (H, W), true where the rectified right pixel is interpolated from raw pixels only."""
        return np.equal(self.rectify_right(self._white()), 255)

    @cached_property
    def shown(self) -> float:
        """Share of the rectified image that has a source, 0..1, of the camera that has less."""
        return float(min(self.left_source.mean(), self.right_source.mean()))

    def seen(self, support_px: tuple[int, int]) -> tuple[U8, U8]:
        """Valid pixels of a method: the source masks eroded by the support of its matching cost.

        Args:
            support_px: width and height, odd.

        Returns:
            uint8 (H, W) for the left and the right rectified image: 1 where the whole support has a source.
        """
        support = np.ones((support_px[1], support_px[0]), np.uint8)
        sources = (self.left_source.astype(np.uint8), self.right_source.astype(np.uint8))
        left, right = (cv2.erode(source, support, borderValue=1) for source in sources)
        return np.asarray(left), np.asarray(right)

    def _white(self) -> U8:
        return np.full((self.rig.height, self.rig.width), 255, np.uint8)

    def _remap(self, pixels: AnyPixels, maps: tuple[Any, Any] | None, out: AnyPixels | None, topic: str) -> AnyPixels:
        height, width = pixels.shape[:2]
        self.rig.check_image(width, height, topic)
        if maps is None:
            return pixels
        remapped: AnyPixels = cv2.remap(pixels, *maps, cv2.INTER_LINEAR, dst=out, borderMode=cv2.BORDER_CONSTANT)
        return remapped


def rectification_maps(camera: CameraModel) -> tuple[Any, Any] | None:
    """Fixed-point maps from rectified to raw pixels; None if both are the same."""
    K_rectified = camera.P[:, :3]
    size = (camera.width, camera.height)
    if camera.distortion_model == "equidistant":
        return tuple(cv2.fisheye.initUndistortRectifyMap(camera.K, camera.D, camera.R, K_rectified, size, cv2.CV_16SC2))
    moved = np.abs([camera.R - np.identity(3), camera.K - K_rectified]).max() > 1e-9
    if not moved and not camera.D.any():
        return None
    D = camera.D if camera.D.size else np.zeros(5)
    return tuple(cv2.initUndistortRectifyMap(camera.K, D, camera.R, K_rectified, size, cv2.CV_16SC2))

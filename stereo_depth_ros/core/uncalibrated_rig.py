# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two images whose rows were made to agree without a calibration of the rig: disparities, no meters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64

__all__ = ["UncalibratedRig"]


@dataclass(frozen=True, eq=False)
class UncalibratedRig:
    """What a :class:`~stereo_depth_ros.core.rig.StereoRig` is to the path, but for meters.

    Attributes:
        left, right: K and D of the raw images; R maps rays to the rectified pixels that P, [I | 0], then gives: it
            is a homography and no rotation.
        topics: where each came from, for the messages of errors.
    """

    left: CameraModel
    right: CameraModel
    topics: tuple[str, str] = ("left", "right")

    metric: ClassVar[bool] = False  # a disparity is no depth: where infinity lies is not known
    doffs_px: ClassVar[float] = -np.inf

    @classmethod
    def from_homographies(
        cls,
        H_left: F64,
        H_right: F64,
        size: tuple[int, int],
        cameras: tuple[CameraModel, CameraModel] | None = None,
    ) -> UncalibratedRig:
        """From pixels of images without distortion to rectified ones.

        Args:
            H_left, H_right: float64 (3, 3).
            size: width, height of raw and rectified images, px.
            cameras: whose distortion is removed first; of them K and D are used. None for images that have none.

        Raises:
            CalibrationError: cameras of another size.
        """
        bare = CameraModel(*size, "plumb_bob", np.identity(3), np.zeros(5), np.identity(3), np.identity(4)[:3])
        sides = cameras or (bare, replace(bare))
        for camera, side in zip(sides, ("left", "right"), strict=True):
            if (camera.width, camera.height) != size:
                raise CalibrationError(
                    f"{side} camera is {camera.width}x{camera.height}, the homographies are for {size[0]}x{size[1]}: "
                    "estimate them from images of this camera"
                )
        left, right = (
            replace(camera, R=H @ camera.K, P=np.identity(4)[:3])
            for camera, H in zip(sides, (H_left, H_right), strict=True)
        )
        return cls(left, right)

    @property
    def width(self) -> int:
        """Width of raw and rectified images, px."""
        return self.left.width

    @property
    def height(self) -> int:
        """Height of raw and rectified images, px."""
        return self.left.height

    def check_image(self, width: int, height: int, topic: str) -> None:
        """Refuses an image of another size.

        Raises:
            CalibrationError: the sizes differ.
        """
        if (width, height) != (self.width, self.height):
            raise CalibrationError(
                f"{topic}: the image is {width}x{height}, the homographies are for {self.width}x{self.height}: "
                "estimate them from images of this size"
            )

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rig of two images rectified without a calibration: disparities, but no depth in meters."""

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
    """A rig for the pipeline like :class:`~stereo_depth_ros.core.rig.StereoRig`, without depth in meters.

    Attributes:
        left, right: K and D of the raw images; R is a homography from rays to rectified pixels, not a
            rotation; P is [I | 0].
        topics: source of each camera, for error messages.
    """

    left: CameraModel
    right: CameraModel
    topics: tuple[str, str] = ("left", "right")

    metric: ClassVar[bool] = False  # the disparity of infinity is not known
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
            cameras: K and D, with which distortion is removed first. None for images without distortion.

        Raises:
            CalibrationError: cameras of another size.
        """
        bare = CameraModel(*size, "plumb_bob", np.identity(3), np.zeros(5), np.identity(3), np.identity(4)[:3])
        sides = cameras or (bare, replace(bare))
        for camera, side in zip(sides, ("left", "right"), strict=True):
            if (camera.width, camera.height) != size:
                raise CalibrationError(
                    f"size is {camera.width}x{camera.height}, the homographies are for {size[0]}x{size[1]}",
                    subject=f"{side} camera",
                    value=(camera.width, camera.height),
                    limit=size,
                    remedy="estimate them from images of this camera",
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
        """Check the size of an image.

        Raises:
            CalibrationError: the sizes differ.
        """
        if (width, height) != (self.width, self.height):
            raise CalibrationError(
                f"the image is {width}x{height}, the homographies are for {self.width}x{self.height}",
                subject=topic,
                value=(width, height),
                limit=(self.width, self.height),
                remedy="estimate them from images of this size",
            )

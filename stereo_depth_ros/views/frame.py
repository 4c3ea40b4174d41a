# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What views are computed from: both rectified images, and the disparities as they are published."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.core.types import F32, U8, StereoPair
from stereo_depth_ros.messages.disparity import published_disparity, published_triangulation
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.stages.depth import depth_from_disparity
from stereo_depth_ros.views.color_order import as_bgr, bgr_pixels

__all__ = ["RECTIFIED", "ViewFrame"]

RECTIFIED = ("left/image_rect_color", "right/image_rect_color")


@dataclass(frozen=True, eq=False)
class ViewFrame:
    """Disparities and, where a view needs them, both images.

    Attributes:
        published_px: float32 (H, W), x_left - x_right - doffs, NaN where invalid, see ``messages/disparity.py``.
        doffs_px: cx_left - cx_right.
        range_px: smallest and largest published disparity that was searched.
        triangulation: conversion of the published disparities to depth; None without a calibration.
        left, right: uint8 (H, W) or (H, W, 3) BGR, rectified; None where only disparities are needed.
        stamp_ns, frame_id: of the left image.
    """

    published_px: F32
    doffs_px: float
    range_px: tuple[float, float]
    triangulation: Triangulation | None
    left: U8 | None = None
    right: U8 | None = None
    stamp_ns: int = 0
    frame_id: str = ""

    @classmethod
    def of_message(cls, message: Any, rig: StereoRig, pair: StereoPair | None, topic: str) -> ViewFrame:
        """The frame of a DisparityImage and the rectified pair of its stamp.

        Raises:
            MessageError: a message that is not valid, or not of this rig.
        """
        images = {
            side: bgr_pixels(frame.pixels, frame.encoding)
            for side, frame in ((("left", pair.left), ("right", pair.right)) if pair else ())
        }
        if len({image.ndim for image in images.values()}) > 1:  # one camera has color and the other has not
            images = {side: as_bgr(image) for side, image in images.items()}
        return cls(
            published_disparity(message, topic),
            rig.doffs_px,
            (message.min_disparity, message.max_disparity),
            published_triangulation(message, rig, topic),
            stamp_ns=stamp_ns(message.header),
            frame_id=message.header.frame_id,
            **images,
        )

    @cached_property
    def disparity_px(self) -> F32:
        """x_left - x_right, float32 (H, W), NaN where invalid."""
        return self.published_px + np.float32(self.doffs_px)

    @cached_property
    def depth_m(self) -> F32:
        """Depth, float32 (H, W), meters, NaN where invalid; of a calibrated rig."""
        assert self.triangulation is not None  # views in meters are refused without a calibration
        return depth_from_disparity(self.published_px, self.triangulation)

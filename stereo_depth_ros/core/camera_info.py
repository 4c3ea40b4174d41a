# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera model from a CameraInfo message, of rclpy or rosbags."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64

__all__ = ["camera_from_info", "sensor_intrinsics"]


def camera_from_info(info: Any, topic: str = "") -> CameraModel:
    """The camera of a sensor_msgs/CameraInfo, for the image as published.

    The region of interest shifts the principal points of K and P, then binning divides both, as in image_geometry:
    column 0 of an image is column ``roi.x_offset`` of the sensor. A region without size is the whole sensor, binning 0
    means 1, ``roi.do_rectify`` is ignored. Where only P is set, the images are taken as rectified.

    Args:
        info: the message, of any family.
        topic: its topic, for error messages.

    Raises:
        CalibrationError: a region of interest that leaves the sensor, binning above its size, or a matrix with another
            number of values.
    """
    width, height, to_image = _published_image(info, topic)
    try:
        sensor = CameraModel(
            width, height, info.distortion_model, info.k, np.array(info.d), info.r, info.p, info.header.frame_id
        )
    except CalibrationError as error:
        raise error.about(topic or "camera info") from error
    with np.errstate(invalid="ignore", over="ignore"):  # inf is refused where a camera is checked
        image = replace(sensor, K=to_image @ sensor.K, P=to_image @ sensor.P)
    return image.described()


def sensor_intrinsics(K: F64, info: Any, topic: str = "") -> F64:
    """The K that a camera info must hold so that :func:`camera_from_info` returns this one.

    Args:
        K: float64 (3, 3), intrinsics of the image as published, px.
        info: the message with the region of interest and the binning, of any family; its K is ignored.
        topic: its topic, for error messages.

    Returns:
        float64 (3, 3), intrinsics of the whole sensor before binning, px.

    Raises:
        CalibrationError: a region of interest that leaves the sensor.
    """
    K_sensor: F64 = np.linalg.solve(_published_image(info, topic)[2], K).astype(np.float64)
    return K_sensor


def _published_image(info: Any, topic: str) -> tuple[int, int, F64]:
    """Width and height of the image as published, px, and the float64 (3, 3) from sensor pixels to its pixels."""
    roi = info.roi
    whole = roi.width == 0 and roi.height == 0
    x, y, width, height = (0, 0, info.width, info.height) if whole else _region(info, topic)
    binning_x, binning_y = max(info.binning_x, 1), max(info.binning_y, 1)
    if max(binning_x - width, binning_y - height) > 0 and min(width, height) > 0:
        raise CalibrationError(
            f"binning {binning_x}x{binning_y} is above the size {width}x{height}",
            subject=topic or "camera info",
            value=(binning_x, binning_y),
            limit=(width, height),
            remedy="set the binning of the driver, 1 or 0 without binning",
        )
    to_image = np.array([[1 / binning_x, 0, -x / binning_x], [0, 1 / binning_y, -y / binning_y], [0, 0, 1]])
    return width // binning_x, height // binning_y, to_image


def _region(info: Any, topic: str) -> tuple[int, int, int, int]:
    roi = info.roi
    right, bottom = roi.x_offset + roi.width, roi.y_offset + roi.height
    if roi.width == 0 or roi.height == 0 or right > info.width or bottom > info.height:
        raise CalibrationError(
            f"roi {roi.width}x{roi.height} at ({roi.x_offset}, {roi.y_offset}) is not inside the sensor of "
            f"{info.width}x{info.height}",
            subject=topic or "camera info",
            value=(roi.x_offset, roi.y_offset, roi.width, roi.height),
            limit=(info.width, info.height),
            remedy="set width and height of the full resolution, before binning",
        )
    return roi.x_offset, roi.y_offset, roi.width, roi.height

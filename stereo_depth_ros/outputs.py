# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table of the outputs: topic, type and message builder of each, in the order of publishing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.types import F32, U8, U16, Frame
from stereo_depth_ros.messages.camera_info import rectified_camera_info
from stereo_depth_ros.messages.depth import depth_message
from stereo_depth_ros.messages.disparity import match_message
from stereo_depth_ros.messages.encodings import ENCODINGS, without_alpha
from stereo_depth_ros.messages.image import image_message
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.point_cloud import cloud_message
from stereo_depth_ros.messages.types import MessageTypes
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.stages.point_cloud import CloudLayout
from stereo_depth_ros.stages.reason_colors import reason_colors

__all__ = ["LIVE_OUTPUTS", "MATCH_OUTPUTS", "MORE_OUTPUTS", "OUTPUTS", "Output", "ResultMessages"]


class ResultMessages:
    """Builds the messages of results; a message is valid until the next of its kind is built."""

    def __init__(self, types: MessageTypes) -> None:
        self._types = types
        self._pool = PayloadPool(types)
        self._color_depth = BitDepth()

    def restart(self) -> None:
        """A new stream begins: its 16-bit colors have a depth of their own."""
        self._color_depth.restart()

    def left_rectified(self, result: StereoResult) -> Any:
        """The left rectified image, gray."""
        return self._gray("left", result.rectified.left, result.rectified.left_16, result.pair.left)

    def left_rectified_color(self, result: StereoResult) -> Any:
        """The left rectified image in its original encoding."""
        return self._image("left color", *result.left_image, result.pair.left)

    def right_rectified(self, result: StereoResult) -> Any:
        """The right rectified image, gray."""
        return self._gray("right", result.rectified.right, result.rectified.right_16, result.pair.right)

    def right_rectified_color(self, result: StereoResult) -> Any:
        """The right rectified image in its original encoding."""
        return self._image("right color", *result.right_image, result.pair.right)

    def disparity(self, result: StereoResult) -> Any:
        """The DisparityImage."""
        matching = result.config.matching
        return match_message(
            self._types, self._pool, result.disparity, matching, result.calibrated_rig, result.pair.left
        )

    def depth(self, result: StereoResult) -> Any:
        """The depth image, meters or millimeters as configured."""
        encoding = result.config.depth.depth_encoding
        return depth_message(self._types, self._pool, result.depth_m, encoding, result.stamp_ns, result.frame_id)

    def confidence(self, result: StereoResult) -> Any:
        """Confidence of the disparities, 32FC1, 0..1; 0 where invalid."""
        return self._image("confidence", _confidence(result), "32FC1", result.pair.left)

    def confidence_mono8(self, result: StereoResult) -> Any:
        """The same in gray: 255 is 1."""
        gray = np.rint(np.float32(255) * _confidence(result)).astype(np.uint8)
        return self._image("gray confidence", gray, "mono8", result.pair.left)

    def reasons_color(self, result: StereoResult) -> Any:
        """The left image with the pixels that have no disparity in the color of their reason, bgr8."""
        colors = reason_colors(result.disparity.reasons, result.rectified.left)
        return self._image("reasons", colors, "bgr8", result.pair.left)

    def disparity_error(self, result: StereoResult) -> Any:
        """Standard deviation of the disparities, 32FC1, px, NaN where invalid."""
        return self._image("disparity error", result.sigma_px, "32FC1", result.pair.left)

    def depth_error(self, result: StereoResult) -> Any:
        """Standard deviation of the depth, 32FC1, meters, NaN where invalid."""
        return self._image("depth error", result.sigma_m, "32FC1", result.pair.left)

    def depth_camera_info(self, result: StereoResult) -> Any:
        """The camera info of the depth image: no distortion, no rotation."""
        return rectified_camera_info(self._types, result.rig.left, result.stamp_ns, result.frame_id)

    def cloud(self, result: StereoResult) -> Any:
        """The point cloud."""
        layout = CloudLayout.of(result.config.cloud)
        disparity_px = result.disparity.disparity_px
        color, encoding = self._color(result) if layout.rgb_offset is not None else (None, "mono8")
        return cloud_message(
            self._types,
            disparity_px,
            result.triangulation,
            layout,
            stamp_ns=result.stamp_ns,
            frame_id=result.frame_id,
            color=color,
            color_encoding=encoding,
            quality=None if layout.quality_offset is None else (_confidence(result), result.sigma_m),
            payload=self._pool.get(f"cloud {layout}", disparity_px.size * layout.point_step),
        )

    def _color(self, result: StereoResult) -> tuple[U8, str]:
        """8 bits of the left rectified image without alpha, as point_cloud_node has them from its message."""
        pixels, encoding = result.left_image
        pixels = without_alpha(pixels)
        self._color_depth.include(pixels)
        return self._color_depth.to_8_bit(pixels), ENCODINGS[encoding].decoded

    def _gray(self, kind: str, gray: U8, gray_16: U16 | None, source: Frame) -> Any:
        if gray_16 is not None:
            return self._image(kind, gray_16, "mono16", source)
        return self._image(kind, gray, "mono8", source)

    def _image(self, kind: str, pixels: NDArray[Any], encoding: str, source: Frame) -> Any:
        payload = self._pool.get(kind, pixels.nbytes)
        return image_message(self._types, pixels, encoding, source.stamp_ns, source.frame_id, payload)


def _confidence(result: StereoResult) -> F32:
    """That of the matcher; without one, 1 where valid."""
    found = result.disparity.confidence
    return (result.disparity.reasons == 0).astype(np.float32) if found is None else found


class Output(NamedTuple):
    """One output of the pipeline.

    Attributes:
        topic: relative to the namespace.
        msgtype: message type, ``package/msg/Name``.
        build: builds the message of a result.
    """

    topic: str
    msgtype: str
    build: Callable[[ResultMessages, StereoResult], Any]


# What takes less time to build and send is published first, so that the cloud holds back nothing. Used by the fused
# node, the offline engine and the replay.
OUTPUTS = (
    Output("disparity", "stereo_msgs/msg/DisparityImage", ResultMessages.disparity),
    Output("depth/image_rect", "sensor_msgs/msg/Image", ResultMessages.depth),
    Output("depth/camera_info", "sensor_msgs/msg/CameraInfo", ResultMessages.depth_camera_info),
    Output("points2", "sensor_msgs/msg/PointCloud2", ResultMessages.cloud),
    Output("left/image_rect", "sensor_msgs/msg/Image", ResultMessages.left_rectified),
    Output("left/image_rect_color", "sensor_msgs/msg/Image", ResultMessages.left_rectified_color),
    Output("right/image_rect", "sensor_msgs/msg/Image", ResultMessages.right_rectified),
)

# Not recorded unless asked for, so that bags do not grow.
MORE_OUTPUTS = (
    Output("right/image_rect_color", "sensor_msgs/msg/Image", ResultMessages.right_rectified_color),
    Output("confidence", "sensor_msgs/msg/Image", ResultMessages.confidence),
    Output("confidence_mono8", "sensor_msgs/msg/Image", ResultMessages.confidence_mono8),
    Output("reasons_color", "sensor_msgs/msg/Image", ResultMessages.reasons_color),
    Output("error_disparity", "sensor_msgs/msg/Image", ResultMessages.disparity_error),
    Output("error_depth", "sensor_msgs/msg/Image", ResultMessages.depth_error),
)

# Of them, what follows from the rectified images and their disparities: published by disparity_node too
MATCH_OUTPUTS = tuple(row for row in MORE_OUTPUTS if row.topic != "right/image_rect_color")

LIVE_OUTPUTS = (*OUTPUTS, *MORE_OUTPUTS)  # of the fused node

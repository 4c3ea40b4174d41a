# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of a result; the fused node publishes them and the offline engine writes them."""

from __future__ import annotations

from typing import Any

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.depth import millimetres
from stereo_depth_ros.io.camera_info_message import rectified_camera_info
from stereo_depth_ros.io.cloud_message import cloud_message
from stereo_depth_ros.io.disparity_message import disparity_message
from stereo_depth_ros.io.image_message import image_message
from stereo_depth_ros.io.message_types import MessageTypes
from stereo_depth_ros.pipeline import StereoResult
from stereo_depth_ros.point_cloud import CloudLayout
from stereo_depth_ros.stereo_rig import StereoRig
from stereo_depth_ros.types import F32, U8, Frame, MatchResult

__all__ = ["PayloadPool", "ResultMessages", "depth_message", "match_message"]


class PayloadPool:
    """Message payloads that are used again for every frame: a message is good until the next of its kind is made."""

    def __init__(self, types: MessageTypes) -> None:
        self._types = types
        self._payloads: dict[tuple[str, int], tuple[Any, U8]] = {}

    def get(self, kind: str, nbytes: int) -> tuple[Any, U8]:
        """The payload of that kind and size, zeroed when it is first made."""
        key = (kind, nbytes)
        if key not in self._payloads:
            self._payloads = {k: v for k, v in self._payloads.items() if k[0] != kind}
            self._payloads[key] = self._types.payload(nbytes)
        return self._payloads[key]


class ResultMessages:
    """Builds the messages of results; each is good until the next of its kind is built."""

    def __init__(self, types: MessageTypes) -> None:
        self._types = types
        self._pool = PayloadPool(types)

    def left_rectified(self, result: StereoResult) -> Any:
        """The left rectified image, grey."""
        return self._image("left", result.rectified.left, "mono8", result.pair.left)

    def left_rectified_color(self, result: StereoResult) -> Any:
        """The left rectified image in the colours it came in."""
        rectified = result.rectified
        return self._image("left color", rectified.left_color, rectified.color_encoding, result.pair.left)

    def right_rectified(self, result: StereoResult) -> Any:
        """The right rectified image, grey."""
        return self._image("right", result.rectified.right, "mono8", result.pair.right)

    def disparity(self, result: StereoResult) -> Any:
        """The DisparityImage."""
        matching = result.config.matching
        return match_message(
            self._types, self._pool, result.disparity, matching, result.calibrated_rig, result.pair.left
        )

    def depth(self, result: StereoResult) -> Any:
        """The depth image, metres or millimetres as configured."""
        encoding = result.config.depth.depth_encoding
        return depth_message(self._types, self._pool, result.depth_m, encoding, result.stamp_ns, result.frame_id)

    def depth_camera_info(self, result: StereoResult) -> Any:
        """The camera info of the depth image: no distortion, no rotation."""
        return rectified_camera_info(self._types, result.rig.left, result.stamp_ns, result.frame_id)

    def cloud(self, result: StereoResult) -> Any:
        """The point cloud."""
        layout = CloudLayout.of(result.config.cloud)
        disparity_px = result.disparity.disparity_px
        return cloud_message(
            self._types,
            disparity_px,
            result.triangulation,
            layout,
            stamp_ns=result.stamp_ns,
            frame_id=result.frame_id,
            color=result.rectified.left_color,
            color_encoding=result.rectified.color_encoding,
            payload=self._pool.get(f"cloud {layout}", disparity_px.size * layout.point_step),
        )

    def _image(self, kind: str, pixels: U8, encoding: str, source: Frame) -> Any:
        payload = self._pool.get(kind, pixels.nbytes)
        return image_message(self._types, pixels, encoding, source.stamp_ns, source.frame_id, payload)


def match_message(
    types: MessageTypes, pool: PayloadPool, match: MatchResult, config: MatchingConfig, rig: StereoRig, left: Frame
) -> Any:
    """The DisparityImage of a match, with the header of the left frame."""
    return disparity_message(
        types,
        match.disparity_px,
        rig,
        min_disparity=config.min_disparity,
        max_disparity=config.max_disparity,
        step_px=match.step_px,
        stamp_ns=left.stamp_ns,
        frame_id=left.frame_id,
        window_size=config.correlation_window_size,
        payload=pool.get("disparity", match.disparity_px.nbytes),
    )


def depth_message(
    types: MessageTypes, pool: PayloadPool, depth_m: F32, encoding: str, stamp_ns: int, frame_id: str
) -> Any:
    """A REP 118 depth image of float32 (H, W) metres: 32FC1 with NaN, or 16UC1 millimetres with 0."""
    pixels = depth_m if encoding == "32FC1" else millimetres(depth_m)
    payload = pool.get("depth", pixels.nbytes)
    return image_message(types, pixels, encoding, stamp_ns, frame_id, payload)

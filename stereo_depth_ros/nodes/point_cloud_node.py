# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Computes points from published disparities: disparity and the left rectified image to points2."""

from __future__ import annotations

from typing import Any

from stereo_depth_ros.config import CameraInfoConfig, CloudConfig, PairingConfig
from stereo_depth_ros.core.bit_depth import BitDepth
from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.depth import float_pixels
from stereo_depth_ros.messages.disparity import published_disparity, published_triangulation
from stereo_depth_ros.messages.payloads import PayloadPool
from stereo_depth_ros.messages.point_cloud import cloud_message
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.followed_images import FollowedImages
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, NodeInterface
from stereo_depth_ros.nodes.pair_input import PairInput, decode_from
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.stages.point_cloud import CloudLayout

__all__ = ["PointCloudNode", "main"]

_COLOR = "left/image_rect_color"
_QUALITY = "confidence", "error_depth"
_COLOR_BYTES = 256 << 20  # of the images that wait for their disparities
_COLOR_DEPTH = 30  # images that arrive while one cloud is built


class PointCloudNode(StereoNode):
    """While use_color is false it does not wait for an image.

    A color image is kept until its disparity arrives, however long the matcher takes: 256 MiB of them, and queue_size
    images at least. With point_quality it waits for confidence and error_depth of disparity_node too.
    """

    interface = NodeInterface(
        "point_cloud_node",
        configs=(PairingConfig, CameraInfoConfig, CloudConfig),
        inputs={
            **CAMERA_INFOS,
            "disparity": "stereo_msgs/msg/DisparityImage",
            **dict.fromkeys((_COLOR, *_QUALITY), "sensor_msgs/msg/Image"),
        },
        outputs={"points2": "sensor_msgs/msg/PointCloud2"},
    )

    def __init__(self) -> None:
        super().__init__()
        self._pool = PayloadPool(self.types)
        self._calibration = CalibrationInput(self, rectified=True)
        self._output = self.add_output("points2")
        self._depth = BitDepth()
        self.on_idle.append(self._depth.restart)
        self._pairs = PairInput(self, "disparity", _COLOR, self._on_pair)
        self.add_input("disparity", self._receive)
        self._images = self.add_input(_COLOR, self._receive_image, lambda: self._config.use_color, _COLOR_DEPTH)
        self._quality = FollowedImages(self, _QUALITY, lambda: self._config.point_quality, self._on_quality)

    @property
    def _config(self) -> CloudConfig:
        return self.parameters.get(CloudConfig)

    def _receive(self, disparity: Any) -> None:
        if self._config.use_color:
            self._images.take_waiting()  # its own is among them; the executor takes one for each disparity
            self._pairs.add_left(disparity)
        else:
            self._on_pair(disparity, None)

    def _receive_image(self, image: Any) -> None:
        limit = self._pairs.keep_right(_COLOR_BYTES // max(1, len(image.data)))
        self._pairs.add_right(image)
        kept = f"{self._pairs.waiting_right}, limit {limit} ({_COLOR_BYTES >> 20} MiB)"
        self.diagnostics.facts["color images kept"] = kept

    def _on_pair(self, disparity: Any, image: Any) -> None:
        if self._config.point_quality:
            self._quality.add(stamp_ns(disparity.header), (disparity, image))
        else:
            self._on_frame(disparity, image, [])

    def _on_quality(self, pair: tuple[Any, Any], quality: list[Any]) -> None:
        self._on_frame(*pair, quality)

    def _on_frame(self, disparity: Any, image: Any, quality: list[Any]) -> None:
        self._calibration.with_rig(lambda rig: self._publish(disparity, image, quality, rig), disparity)

    def _publish(self, disparity: Any, image: Any, quality: list[Any], rig: StereoRig) -> None:
        layout = CloudLayout.of(self._config)
        if (image is None and layout.rgb_offset is not None) or (layout.quality_offset is not None and not quality):
            return  # use_color or point_quality was switched on meanwhile
        try:
            message = self._cloud(disparity, image, quality, rig, layout)
        except ImageError as error:
            raise error.about(self.resolve_topic_name(_COLOR)) from error
        self._output.publish(message)

    def _cloud(self, disparity: Any, image: Any, quality: list[Any], rig: StereoRig, layout: CloudLayout) -> Any:
        topic = self.resolve_topic_name("disparity")
        color = None if image is None else decode_from(self, _COLOR, image, self._depth)
        given = [float_pixels(each, self.resolve_topic_name(t)) for each, t in zip(quality, _QUALITY, strict=False)]
        with self.diagnostics.timed("cloud"):
            disparity_px = published_disparity(disparity, topic)
            return cloud_message(
                self.types,
                disparity_px,
                published_triangulation(disparity, rig, topic),
                layout,
                stamp_ns=stamp_ns(disparity.header),
                frame_id=disparity.header.frame_id,
                color=None if color is None else color.pixels,
                color_encoding="mono8" if color is None else color.encoding,
                quality=(given[0], given[1]) if layout.quality_offset is not None else None,
                payload=self._pool.get(f"cloud {layout}", disparity_px.size * layout.point_step),
            )


def main() -> int:
    """Run the node."""
    return run(PointCloudNode)


if __name__ == "__main__":
    raise SystemExit(main())

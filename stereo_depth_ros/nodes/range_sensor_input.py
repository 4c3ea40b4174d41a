# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A range sensor of a live graph: subscribed by the type that its publisher has, PointCloud2, LaserScan or Image."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType

from stereo_depth_ros.bags.topics import INFO_TYPE
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.messages.range_sensor import IMAGE_TYPE, RANGE_TYPES, depth_info_topic, range_points
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.ranging.sensor_points import DEFAULT_SIGMA_M, SensorPoints

__all__ = ["RangeSensorInput"]

_LOOK_S = 0.5  # between two looks for a publisher


class RangeSensorInput:
    """Subscribes as soon as the topic has a publisher.

    Args:
        node: subscribes.
        topic: of the sensor.
        callback: takes the points of a sweep.

    Attributes:
        topic: its full name.
        msgtype: type of its messages; empty until there is a publisher.
    """

    def __init__(self, node: StereoNode, topic: str, callback: Callable[[SensorPoints], None]) -> None:
        self._node = node
        self._callback = callback
        self._camera: CameraModel | None = None
        self.topic = str(node.resolve_topic_name(topic))
        self.msgtype = ""
        self._timer = node.create_timer(_LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _look(self) -> None:
        """Subscribe where there is a publisher of a known type; another type is reported."""
        with self._node.diagnostics.catch():
            types = {info.topic_type for info in self._node.get_publishers_info_by_topic(self.topic)}
            known = [kind for kind in RANGE_TYPES if kind in types]
            if types and not known:
                raise TopicError(
                    f"is {', '.join(sorted(types))}, not a range sensor",
                    subject=self.topic,
                    value=sorted(types),
                    limit=RANGE_TYPES,
                    remedy=f"name a topic of {', '.join(RANGE_TYPES)}",
                    settings=("range_sensor",),
                )
            if known:
                self._timer.cancel()
                self.msgtype = known[0]
                if self.msgtype == IMAGE_TYPE:
                    self._node.add_found_input(depth_info_topic(self.topic), INFO_TYPE, self._on_info)
                self._node.add_found_input(self.topic, self.msgtype, self._on_message)

    def _on_info(self, info: Any) -> None:
        self._camera = camera_from_info(info, depth_info_topic(self.topic))

    def _on_message(self, message: Any) -> None:
        if self.msgtype == IMAGE_TYPE and self._camera is None:
            self._node.diagnostics.counters["depth images before their camera info"] += 1
            return
        self._callback(range_points(message, self.topic, self._camera, DEFAULT_SIGMA_M))

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sweeps of a range sensor in a bag: its messages by stamp, their period, and the camera of depth images."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.stamped import StampedMessages
from stereo_depth_ros.bags.topics import INFO_TYPE
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import camera_from_info
from stereo_depth_ros.core.errors import MessageError, TopicError
from stereo_depth_ros.messages.range_sensor import IMAGE_TYPE, RANGE_TYPES, depth_info_topic, range_points
from stereo_depth_ros.ranging.sensor_points import SensorPoints

__all__ = ["Sweeps"]

_PERIOD_OF = 50  # sweeps, of which the period is measured
_ONLY_ONE_NS = 10**8  # period of a topic with one sweep


class Sweeps:
    """The sweeps on a topic, in the order of their stamps.

    Args:
        reader: the open bag.
        topic: of type PointCloud2, LaserScan, or Image, a depth image with camera_info beside it.
        sigma_m: standard deviation of the ranges, meters.

    Attributes:
        msgtype: type of the messages.
        period_ns: median time between two of them, nanoseconds.
        frame_id: frame of the first one.

    Raises:
        TopicError: no such topic, or another type; a depth image without camera info.
        MessageError: no message has a stamp.
    """

    def __init__(self, reader: BagReader, topic: str, sigma_m: float) -> None:
        self._reader, self._topic, self._sigma_m = reader, topic, sigma_m
        self.msgtype = _checked_type(reader, topic)
        self._camera = self._camera_of_images() if self.msgtype == IMAGE_TYPE else None
        stamped = StampedMessages()
        first = list(itertools.islice(stamped.read(reader.messages([topic])), _PERIOD_OF))
        if not first:
            raise stamped.error or MessageError(
                "has no messages", subject=topic, value=0, remedy="record it again, or name another topic"
            )
        gaps = np.diff(sorted(stamp for stamp, _ in first))
        self.period_ns = int(np.median(gaps)) if gaps.size else _ONLY_ONE_NS
        self.frame_id = str(reader.deserialize(first[0][1]).header.frame_id)
        self._sweeps = self._read()
        self._before: tuple[int, bytes] | None = None
        self._next = next(self._sweeps, None)

    def nearest(self, stamp_ns: int) -> tuple[int, bytes] | None:
        """Stamp and bytes of the sweep that is nearest to a time; None without any. Times are asked in their order."""
        while self._next is not None and self._next[0] < stamp_ns:
            self._before, self._next = self._next, next(self._sweeps, None)
        both = [sweep for sweep in (self._before, self._next) if sweep is not None]
        return min(both, key=lambda sweep: abs(sweep[0] - stamp_ns), default=None)

    def points(self, data: bytes) -> SensorPoints:
        """The points of a sweep.

        Raises:
            MessageError: as :func:`range_points`.
        """
        message = self._reader.types.deserialize(data, self.msgtype)
        return range_points(message, self._topic, self._camera, self._sigma_m)

    def _read(self) -> Iterator[tuple[int, bytes]]:
        for stamp_ns, message in StampedMessages().read(self._reader.messages([self._topic])):
            yield stamp_ns, message.data

    def _camera_of_images(self) -> CameraModel:
        topic = depth_info_topic(self._topic)
        known = self._reader.topics.get(topic)
        message = None
        if known is not None and known.msgtype == INFO_TYPE:
            message = next(self._reader.messages([topic]), None)
        if message is None:
            raise TopicError(
                f"the depth images of {self._topic} have no camera info on {topic}",
                subject=str(self._reader.path),
                value=topic,
                limit=INFO_TYPE,
                remedy="record the camera info of the depth camera too",
            )
        return camera_from_info(self._reader.deserialize(message), topic)


def _checked_type(reader: BagReader, topic: str) -> str:
    of_sensors = [
        name
        for name, info in reader.topics.items()
        if info.msgtype in RANGE_TYPES and (info.msgtype != IMAGE_TYPE or "depth" in name)
    ]
    found = reader.topics.get(topic)
    if found is None or found.msgtype not in RANGE_TYPES:
        problem = f"has no topic {topic}" if found is None else f"{topic} is {found.msgtype}, not a range sensor"
        raise TopicError(
            problem,
            subject=str(reader.path),
            value=topic,
            limit=RANGE_TYPES,
            remedy=f"choose among {', '.join(of_sensors)}" if of_sensors else "record the range sensor too",
            settings=("truth",),
        )
    return found.msgtype

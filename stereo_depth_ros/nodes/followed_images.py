# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images of float32 that belong to frames of other topics, by their stamps."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode

__all__ = ["FollowedImages"]

_KEPT = 30  # stamps that wait for the rest of their messages


class FollowedImages:
    """A frame is delivered when all images with its stamp are there, before or after it.

    Args:
        node: subscribes, and counts the frames that are dropped because images of theirs did not come.
        topics: of the images, relative to the namespace; raw.
        wanted: whether they are needed now.
        deliver: takes a frame and its images, in the order of the topics.
    """

    def __init__(
        self,
        node: StereoNode,
        topics: Sequence[str],
        wanted: Callable[[], bool],
        deliver: Callable[[Any, list[Any]], None],
    ) -> None:
        self._node, self._topics, self._deliver_frame = node, tuple(topics), deliver
        self._frames: dict[int, Any] = {}
        self._images: dict[int, dict[str, Any]] = {}
        names = " and ".join(node.resolve_topic_name(topic) for topic in topics)
        self._dropped = f"frames without {names}"
        cause = f"a publisher of {names} is missing or has other stamps than the disparities"
        node.diagnostics.watch_loss(self._dropped, lambda: cause)
        for topic in topics:
            node.add_found_input(topic, "sensor_msgs/msg/Image", functools.partial(self._receive, topic), wanted)
        node.on_idle.append(self._forget)

    def add(self, stamp: int, frame: Any) -> None:
        """A frame, delivered now or when its images have come; the oldest is dropped where many wait."""
        self._frames[stamp] = frame
        if self._deliver(stamp):
            return
        if len(self._frames) > _KEPT:
            self._frames.pop(next(iter(self._frames)))
            self._node.diagnostics.counters[self._dropped] += 1

    def _receive(self, topic: str, message: Any) -> None:
        stamp = stamp_ns(message.header, self._node.resolve_topic_name(topic))
        self._images.setdefault(stamp, {})[topic] = message
        if not self._deliver(stamp) and len(self._images) > 2 * _KEPT:  # some are of frames that were dropped
            self._images.pop(next(iter(self._images)))

    def _deliver(self, stamp: int) -> bool:
        images = self._images.get(stamp, {})
        if stamp not in self._frames or len(images) < len(self._topics):
            return False
        del self._images[stamp]
        self._deliver_frame(self._frames.pop(stamp), [images[topic] for topic in self._topics])
        return True

    def _forget(self) -> None:
        self._frames.clear()
        self._images.clear()

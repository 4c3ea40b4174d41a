# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rig of a node from the two camera infos it receives; what arrives before them waits."""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import CameraInfo

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.errors import CalibrationError
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.stereo_rig import StereoRig

__all__ = ["CalibrationInput"]

_LEFT, _RIGHT = "left/camera_info", "right/camera_info"


class CalibrationInput:
    """Holds the rig: made when both camera infos are there, made again when one of them changes.

    Args:
        node: subscribes left/camera_info and right/camera_info.
    """

    def __init__(self, node: StereoNode) -> None:
        self._node = node
        self._infos: dict[str, Any] = {}
        self._contents: dict[str, Any] = {}
        self._rig: StereoRig | None = None
        self._waiting: deque[Callable[[StereoRig], None]] = deque()
        node.refuse_equal_topics(_LEFT, _RIGHT)
        for topic in (_LEFT, _RIGHT):
            node.add_input(CameraInfo, topic, functools.partial(self._receive, topic))

    def with_rig(self, use: Callable[[StereoRig], None]) -> None:
        """Call ``use`` with the rig, now or as soon as it is known; dropped, and counted, while it is not valid.

        Raises:
            CalibrationError: the camera infos that have arrived describe no rig.
        """
        if self._rig is not None:
            use(self._rig)
        elif len(self._infos) == 2:
            self._node.health.counters["dropped without calibration"] += 1
            self._make_rig()
        else:
            self._waiting.append(use)
            if len(self._waiting) > self._node.parameters.get(PairingConfig).queue_size:
                self._waiting.popleft()
                missing = ", ".join(self._node.resolve_topic_name(t) for t in (_LEFT, _RIGHT) if t not in self._infos)
                self._node.health.counters["dropped without calibration"] += 1
                raise CalibrationError(
                    f"images arrive, but nothing yet on {missing}: publish camera infos, or remap them"
                )

    def _receive(self, topic: str, info: Any) -> None:
        contents = _contents(info)
        if self._contents.get(topic) == contents:
            return
        self._contents[topic] = contents
        self._infos[topic] = info
        self._rig = None
        if len(self._infos) == 2:
            self._make_rig()

    def _make_rig(self) -> None:
        topics = (self._node.resolve_topic_name(_LEFT), self._node.resolve_topic_name(_RIGHT))
        waiting, self._waiting = self._waiting, deque()
        rig = self._rig = StereoRig.from_infos(self._infos[_LEFT], self._infos[_RIGHT], topics)
        for use in waiting:
            with self._node.health.guard():
                use(rig)


def _contents(info: Any) -> tuple[Any, ...]:
    """Everything but the stamp, comparable."""
    roi = info.roi
    window = (roi.x_offset, roi.y_offset, roi.height, roi.width)
    matrices = (bytes(info.d), info.k.tobytes(), info.r.tobytes(), info.p.tobytes())
    binning = (info.binning_x, info.binning_y)
    return info.header.frame_id, info.height, info.width, info.distortion_model, *matrices, *binning, window

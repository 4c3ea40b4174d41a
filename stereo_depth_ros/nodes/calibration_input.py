# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rig of a node from the two camera infos it receives; images that arrive before them wait."""

from __future__ import annotations

import contextlib
import functools
from collections import deque
from collections.abc import Callable
from typing import Any

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.nodes.base import StereoNode

__all__ = ["CalibrationInput", "info_contents"]

_LEFT, _RIGHT = "left/camera_info", "right/camera_info"


class CalibrationInput:
    """Holds the rig: built from both camera infos when it is needed, and rebuilt after one of them has changed.

    Args:
        node: subscribes left/camera_info and right/camera_info.
        rectified: the images of the node are rectified already: K, D and R only tell which of their pixels have a
            source, and P alone counts where they are refused.
    """

    def __init__(self, node: StereoNode, *, rectified: bool = False) -> None:
        self._node = node
        self._rectified = rectified
        self._infos: dict[str, Any] = {}
        self._contents: dict[str, Any] = {}
        self._rig: StereoRig | None = None
        self._waiting: deque[Callable[[StereoRig], None]] = deque()
        node.refuse_equal_topics(_LEFT, _RIGHT)
        for topic in (_LEFT, _RIGHT):
            node.add_input(topic, functools.partial(self._receive, topic))
        node.on_idle.append(self._forget)

    def with_rig(self, use: Callable[[StereoRig], None]) -> None:
        """Call ``use`` with the rig, now or as soon as it is known; dropped and counted while it is not valid.

        Raises:
            CalibrationError: the camera infos received do not describe a rig.
        """
        if len(self._infos) < 2:
            self._wait(use)
            return
        if self._rig is None:
            # Only when it is needed: when both camera infos change, one of them arrives first.
            self._rig = self._build_rig()
        use(self._rig)

    @property
    def right_contents(self) -> tuple[Any, ...] | None:
        """:func:`info_contents` of the newest right camera info; None before the first one."""
        return self._contents.get(_RIGHT)

    def _forget(self) -> None:
        """The cameras may have changed while the node was idle, and an image may arrive before its camera info."""
        self._infos.clear()
        self._contents.clear()
        self._waiting.clear()
        self._rig = None

    def _wait(self, use: Callable[[StereoRig], None]) -> None:
        self._waiting.append(use)
        if len(self._waiting) > self._node.parameters.get(PairingConfig).queue_size:
            self._waiting.popleft()
            self._node.diagnostics.counters["dropped without calibration"] += 1
            missing = ", ".join(self._node.resolve_topic_name(t) for t in (_LEFT, _RIGHT) if t not in self._infos)
            raise CalibrationError(
                f"images arrive, but no message on {missing}",
                value=0,
                limit=1,
                remedy="publish camera infos, or remap them",
            )

    def _receive(self, topic: str, info: Any) -> None:
        contents = info_contents(info)
        if self._contents.get(topic) == contents:
            return
        self._contents[topic] = contents
        self._infos[topic] = info
        self._rig = None
        if len(self._infos) == 2:
            waiting, self._waiting = self._waiting, deque()
            for use in waiting:
                with self._node.diagnostics.catch():
                    self.with_rig(use)

    def _build_rig(self) -> StereoRig:
        topics = (self._node.resolve_topic_name(_LEFT), self._node.resolve_topic_name(_RIGHT))
        left, right = self._infos[_LEFT], self._infos[_RIGHT]
        try:
            if self._rectified:
                with contextlib.suppress(CalibrationError):
                    return StereoRig.from_infos(left, right, topics)
            return StereoRig.from_infos(left, right, topics, rectified=self._rectified)
        except CalibrationError:
            self._node.diagnostics.counters["dropped without calibration"] += 1
            raise


def info_contents(info: Any) -> tuple[Any, ...]:
    """All of a camera info but the stamp, comparable."""
    roi = info.roi
    window = (roi.x_offset, roi.y_offset, roi.height, roi.width)
    matrices = (bytes(info.d), info.k.tobytes(), info.r.tobytes(), info.p.tobytes())
    binning = (info.binning_x, info.binning_y)
    return info.header.frame_id, info.height, info.width, info.distortion_model, *matrices, *binning, window

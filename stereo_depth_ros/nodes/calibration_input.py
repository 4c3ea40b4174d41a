# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rig of each pair from the camera infos of its stamp; pairs wait for camera infos that are still to come."""

from __future__ import annotations

import contextlib
import functools
import operator
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType

from stereo_depth_ros.camera_files.reading import read_rig_files
from stereo_depth_ros.camera_files.urls import camera_info_paths
from stereo_depth_ros.config import CameraInfoConfig, PairingConfig
from stereo_depth_ros.core.calibration_history import CalibrationHistory
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import FIRST_WAIT, StereoNode

__all__ = ["CalibrationInput", "info_contents"]

_TOPICS = ("left/camera_info", "right/camera_info")
_LONGEST_WAIT_S = 0.1  # of a pair for its camera infos, while the calibration changes
# of messages that wait for the first camera infos, of which a driver whose images fill its transport loses several
_FIRST_WAIT_BYTES = 64 << 20
_REMEDY_OF_LOST_INFOS = (
    "their publishers send none, or they are lost in transit: latch them (transient local), or give the driver more "
    "shared memory, as config/fastdds.xml does"
)
_LATE = "late camera infos"


@dataclass(frozen=True)
class _Waiting:
    stamps_ns: tuple[int, int]
    use: Callable[[StereoRig], None]


class CalibrationInput:
    """Builds the rig of the camera infos that apply to a pair, see :class:`CalibrationHistory`.

    A pair waits until both cameras have a camera info: the newest ones, four times ``queue_size`` of them in 64 MiB, or
    ``queue_size``. After that it waits only while the calibration is changing, for the camera infos of its stamps, a
    tenth of a second at most: otherwise those known apply at once. While several cameras publish one topic, a pair
    waits for the camera infos of its own stamps, and is dropped without them: no other ones tell which of the cameras
    it is of.

    With the parameters of :class:`CameraInfoConfig` they are those of calibration files, and no topic is subscribed.

    Args:
        node: subscribes left/camera_info and right/camera_info.
        rectified: the images of the node are rectified already: K, D and R only tell which of their pixels have a
            source, and P alone counts where they are refused.
    """

    def __init__(self, node: StereoNode, *, rectified: bool = False) -> None:
        self._node = node
        self._rectified = rectified
        self._waiting: deque[_Waiting] = deque()
        self._timer = node.create_timer(
            _LONGEST_WAIT_S, self._end_waiting, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._of_files: tuple[Any, Any] | None = None
        self._names = (node.resolve_topic_name(_TOPICS[0]), node.resolve_topic_name(_TOPICS[1]))
        urls = node.parameters.get(CameraInfoConfig)
        if files := camera_info_paths(urls.left_camera_info_url, urls.right_camera_info_url):
            self._read(files)
        else:
            node.refuse_equal_topics(*_TOPICS)
            for side, topic in enumerate(_TOPICS):
                node.add_input(topic, functools.partial(self._receive, side))
        self._forget()
        node.on_idle.append(self._forget)
        node.diagnostics.watch_loss(_LATE, self._cause_of_late_infos)

    def with_rig(self, use: Callable[[StereoRig], None], left: Any, right: Any = None) -> None:
        """Call ``use`` with the rig of a pair, now or as soon as it is known; in the order of the calls.

        Errors of ``use`` and camera infos that do not describe a rig are reported.

        Args:
            use: takes the rig.
            left, right: messages of the pair, whose stamps count; right is None where there is only one.

        Raises:
            CalibrationError: no camera infos arrive; the oldest pair that waits is dropped and counted.
        """
        self._waiting.append(_Waiting((stamp_ns(left.header), stamp_ns((right or left).header)), use))
        self._release()
        if len(self._waiting) > self._limit(left):
            self._release_oldest()

    def _limit(self, message: Any) -> int:
        """Of those that wait."""
        queue_size = self._node.parameters.get(PairingConfig).queue_size
        if self._infos.is_known:
            return queue_size
        size = len(getattr(message, "image", message).data)  # of a DisparityImage that of its image
        return max(queue_size, min(FIRST_WAIT * queue_size, _FIRST_WAIT_BYTES // max(1, size)))

    @property
    def right_contents(self) -> tuple[Any, ...] | None:
        """:func:`info_contents` of the right camera info of the last rig; None before the first one."""
        return None if self._built_from is None else info_contents(self._built_from[1])

    def _forget(self) -> None:
        """The cameras may have changed while the node was idle, and an image may arrive before its camera info."""
        self._timer.cancel()
        self._waiting.clear()
        self._infos: CalibrationHistory[Any] = CalibrationHistory()
        for side, info in enumerate(self._of_files or ()):
            self._infos.add(side, 0, info_contents(info), info)
        self._used_ns = [-1, -1]  # newest stamps whose camera infos were used
        self._built_from: tuple[Any, Any] | None = None
        self._rig: StereoRig | None = None

    def _read(self, files: Sequence[Path]) -> None:
        try:
            rig = read_rig_files(files)
        except CalibrationError as error:
            error.settings += ("left_camera_info_url", "right_camera_info_url")
            raise
        types = self._node.types
        self._of_files = camera_info_message(types, rig.left, 0), camera_info_message(types, rig.right, 0)
        self._names = rig.topics
        self._node.sources.append(f"calibration of {' and '.join(dict.fromkeys(rig.topics))}")

    def _receive(self, side: int, info: Any) -> None:
        stamp = stamp_ns(info.header, self._names[side])
        last_ns = self._infos.last_ns(side)
        changed = self._infos.add(side, stamp, info_contents(info), info)
        if changed and last_ns is not None and last_ns < stamp <= self._used_ns[side]:
            self._node.diagnostics.counters[_LATE] += 1
        self._release()

    def _release(self) -> None:
        """Use the rig for all pairs that need not wait; start the end of waiting for the others."""
        while self._waiting and self._infos.is_known and not self._must_wait(self._waiting[0].stamps_ns):
            self._use(self._waiting.popleft())
        if not (self._waiting and self._infos.is_known):
            self._timer.cancel()
        elif self._timer.is_canceled():
            self._timer.reset()

    def _must_wait(self, stamps_ns: tuple[int, int]) -> bool:
        if self._is_of_unknown_camera(stamps_ns):
            return True
        return self._infos.lacks(stamps_ns) and self._infos.is_changing(stamps_ns)

    def _is_of_unknown_camera(self, stamps_ns: tuple[int, int]) -> bool:
        return self._node.has_mixed_inputs and not self._infos.has_own(stamps_ns)

    def _end_waiting(self) -> None:
        self._timer.cancel()
        while self._waiting:
            self._use_or_drop(self._waiting.popleft())

    def _use_or_drop(self, waiting: _Waiting) -> None:
        if not self._is_of_unknown_camera(waiting.stamps_ns):
            self._use(waiting)
            return
        topics = " or ".join(self._names)
        self._node.diagnostics.report_error(
            "dropped without calibration",
            "several cameras publish the same topics, and a pair without camera infos of its own stamps was dropped, "
            f"because those on {topics} may be of another camera: stop or remap one of the cameras",
        )

    def _release_oldest(self) -> None:
        oldest = self._waiting.popleft()
        if self._infos.is_known:
            self._use_or_drop(oldest)
            return
        self._node.diagnostics.counters["dropped without calibration"] += 1
        missing = [topic for side, topic in enumerate(self._names) if self._infos.last_ns(side) is None]
        published = all(map(self._node.count_publishers, missing))
        raise CalibrationError(
            f"images arrive, but no message on {', '.join(missing)}",
            value=0,
            limit=1,
            remedy=_REMEDY_OF_LOST_INFOS if published else "publish camera infos, or remap them",
        )

    def _use(self, waiting: _Waiting) -> None:
        with self._node.diagnostics.catch():
            self._used_ns = list(map(max, self._used_ns, waiting.stamps_ns))
            waiting.use(self._rig_of(self._infos.at(waiting.stamps_ns)))

    def _rig_of(self, infos: tuple[Any, Any]) -> StereoRig:
        """Kept until another camera info applies."""
        is_built = self._built_from is not None and all(map(operator.is_, self._built_from, infos))
        if self._rig is None or not is_built:
            self._rig = None
            self._rig, self._built_from = self._build_rig(*infos), infos
        return self._rig

    def _build_rig(self, left: Any, right: Any) -> StereoRig:
        try:
            if self._rectified:
                with contextlib.suppress(CalibrationError):
                    return StereoRig.from_infos(left, right, self._names)
            return StereoRig.from_infos(left, right, self._names, rectified=self._rectified)
        except CalibrationError:
            self._node.diagnostics.counters["dropped without calibration"] += 1
            raise

    def _cause_of_late_infos(self) -> str:
        topics = " or ".join(self._names)
        return f"{topics} changed after pairs of its stamp were computed: publish each camera info before its image"


def info_contents(info: Any) -> tuple[Any, ...]:
    """All of a camera info but the stamp, comparable."""
    roi = info.roi
    window = (roi.x_offset, roi.y_offset, roi.height, roi.width)
    matrices = (bytes(info.d), info.k.tobytes(), info.r.tobytes(), info.p.tobytes())
    binning = (info.binning_x, info.binning_y)
    return info.header.frame_id, info.height, info.width, info.distortion_model, *matrices, *binning, window

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishers and subscriptions of the replay: raw pairs, every output, diagnostics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from stereo_depth_ros.bags.pairs import SerializedPair
from stereo_depth_ros.messages.cdr import cdr_stamp_ns
from stereo_depth_ros.nodes.interface import transported
from stereo_depth_ros.nodes.log import log_warning
from stereo_depth_ros.nodes.message_types import message_class
from stereo_depth_ros.nodes.replay.recorder import Recorder
from stereo_depth_ros.offline.report import stage_timings
from stereo_depth_ros.outputs import OUTPUTS

__all__ = ["PUBLISHED", "SUBSCRIBED", "GraphPorts"]

_MSGTYPES = {output.topic: output.msgtype for output in OUTPUTS}
# Messages of the calibration monitor, recorded where it runs; whether they are latched
_NOTES = {
    "health/row_error": ("std_msgs/msg/Float64MultiArray", False),
    "health/correction": ("diagnostic_msgs/msg/DiagnosticArray", True),
}
_DIAGNOSTICS, _CLOCK = "/diagnostics", "/clock"
_INFO_TYPE, _IMAGE_TYPE = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image"
# Topic and type of the fields of a pair; compressed images have another type and a suffix
_SENT = {
    "left_info": ("left/camera_info", _INFO_TYPE),
    "right_info": ("right/camera_info", _INFO_TYPE),
    "left": ("left/image_raw", _IMAGE_TYPE),
    "right": ("right/image_raw", _IMAGE_TYPE),
}
# All topics of the replay, and their types
PUBLISHED = {**dict(_SENT.values()), _CLOCK: "rosgraph_msgs/msg/Clock"}
SUBSCRIBED = {
    **_MSGTYPES,
    **{topic: msgtype for topic, (msgtype, _) in _NOTES.items()},
    _DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE)
_LATCHED_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_ERRORS_LAST_S = 6.0
_MOST_ERRORS = 3  # later ones usually follow from these
_UNSUBSCRIBE_TIMEOUT_S = 1.0  # with other subscribers the nodes stay awake
_SETTLE_S = 0.2


class GraphPorts:
    """All publishers and subscriptions of the replay; serialized messages pass unchanged.

    Args:
        node: owns the endpoints; its namespace holds the topics.
        recorder: of the camera infos sent and of the expected outputs.
        compressed: the bag's images are CompressedImage.
        clock: publish the time of the pairs on /clock.
        views: topics of the view node that are outputs too.

    Attributes:
        output_topics: names of the outputs, relative to the namespace.
        on_output: called with topic, stamp and time of receipt (both ns) of every output; True where it is expected.
    """

    def __init__(
        self, node: Node, recorder: Recorder, compressed: bool, clock: bool, views: Sequence[str] = ()
    ) -> None:
        self._node = node
        self._recorder = recorder
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._publishers = {}
        for field, (topic, msgtype) in _SENT.items():
            topic, msgtype = transported(topic, msgtype, compressed)
            self._publishers[field] = node.create_publisher(message_class(msgtype), topic, _QOS)
        self._clock: Publisher | None = node.create_publisher(Clock, _CLOCK, 10) if clock else None
        self._msgtypes = {**_MSGTYPES, **dict.fromkeys(views, _IMAGE_TYPE)}
        self.output_topics = tuple(self._msgtypes)
        self.on_output: Callable[[str, int, int], bool] = lambda topic, stamp_ns, now_ns: False
        self._subscriptions = self._subscribe()
        for topic, (msgtype, latched) in _NOTES.items():
            node.create_subscription(
                message_class(msgtype),
                topic,
                lambda data, topic=topic: self._note(topic, data),
                _LATCHED_QOS if latched else _QOS,
                raw=True,
            )
        self._sent_ns = 0
        self._statuses: dict[str, Any] = {}
        self._errors: list[str] = []
        self._played_from_s = math.inf  # by the monotonic clock
        node.create_subscription(DiagnosticArray, _DIAGNOSTICS, self._receive_diagnostics, 10)

    def spin(self, timeout_s: float) -> None:
        """Handle received messages, or wait for one up to that time."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def record_infos(self, pair: SerializedPair) -> None:
        """Record the camera infos of a pair."""
        for field, stamp_ns in (("left_info", pair.stamp_ns), ("right_info", pair.right_stamp_ns)):
            self._recorder.write(self._publishers[field].topic_name, _INFO_TYPE, getattr(pair, field), stamp_ns)

    def send_all_but_last(self, pair: SerializedPair) -> None:
        """Publish the time, both camera infos and the left image."""
        self._sent_ns = pair.stamp_ns
        self._played_from_s = min(self._played_from_s, time.monotonic())
        if self._clock is not None:
            self._clock.publish(_clock_message(max(pair.stamp_ns, pair.right_stamp_ns)))
        for field in ("left_info", "right_info"):
            self._publishers[field].publish(getattr(pair, field))
        self._publishers["left"].publish(pair.left)

    def send_last(self, pair: SerializedPair) -> None:
        """Publish the right image."""
        self._publishers["right"].publish(pair.right)

    def obstacles(self) -> list[str]:
        """One phrase for each topic without a subscriber or publisher, or with a publisher of another graph."""
        inputs = [p.topic_name for p in self._publishers.values() if not p.get_subscription_count()]
        outputs = [s.topic_name for s in self._subscriptions.values() if not s.get_publisher_count()]
        missing = [f"{name} has no subscriber" for name in inputs] + [f"{name} has no publisher" for name in outputs]
        return missing + self.intruders()

    def intruders(self) -> list[str]:
        """One phrase for each topic that another graph or a camera publishes too."""
        counts = {name: self._node.count_publishers(name) for name in self._topics()}
        return [f"{name} has {count} publishers, not one" for name, count in counts.items() if count > 1]

    def count_endpoints(self) -> int:
        """Publishers and subscribers of all nodes on all topics of the replay."""
        return sum(self._node.count_publishers(name) + self._node.count_subscribers(name) for name in self._topics())

    def await_diagnostics(self, timeout_s: float) -> None:
        """Wait until every node that publishes diagnostics has done so once more."""
        self._statuses.clear()
        end = time.monotonic() + timeout_s
        while len(self._statuses) < self._node.count_publishers(_DIAGNOSTICS) and time.monotonic() < end:
            self.spin(0.05)

    def stages_ms(self) -> dict[str, tuple[float, float]]:
        """(p50, p95) in milliseconds per "node: stage", from the newest diagnostics."""
        return {
            f"{name}: {stage}": times
            for name, status in sorted(self._statuses.items())
            for stage, times in stage_timings({item.key: item.value for item in status.values}).items()
        }

    def errors_reported(self) -> str:
        """The first errors that the nodes have reported; empty where there are none."""
        return "; ".join(self._errors[:_MOST_ERRORS])

    def reported(self, name: str) -> str:
        """The first value of that name in the newest diagnostics; empty where there is none."""
        values = (item.value for status in self._statuses.values() for item in status.values if item.key == name)
        return next(values, "")

    def warn(self, text: str) -> None:
        """Log a warning."""
        log_warning(self._node.get_logger(), text)

    def close(self) -> None:
        """Unsubscribe, let the nodes unsubscribe too, stop the executor; the node stays the caller's.

        Lazy nodes unsubscribe their inputs once their outputs have no subscriber. Fast DDS 2.14 can hang when a
        participant is deleted at the same time as endpoints of another one: so these are deleted first.
        """
        self._unsubscribe()
        settled = time.monotonic() + _SETTLE_S
        while time.monotonic() < settled:
            self.spin(0.05)
        self._executor.shutdown()

    def subscribe_again(self) -> None:
        """Leave the outputs until the lazy nodes are idle and forget what they have received, then subscribe again."""
        self._unsubscribe()
        self._subscriptions = self._subscribe()

    def _subscribe(self) -> dict[str, Any]:
        return {
            topic: self._node.create_subscription(
                message_class(msgtype), topic, lambda data, topic=topic: self._receive(topic, data), _QOS, raw=True
            )
            for topic, msgtype in self._msgtypes.items()
        }

    def _unsubscribe(self) -> None:
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        end = time.monotonic() + _UNSUBSCRIBE_TIMEOUT_S
        while any(p.get_subscription_count() for p in self._publishers.values()) and time.monotonic() < end:
            self.spin(0.05)

    def _topics(self) -> list[str]:
        ends: list[Any] = [*self._publishers.values(), *self._subscriptions.values()]
        return [str(end.topic_name) for end in ends]

    def _receive(self, topic: str, data: bytes) -> None:
        now_ns, stamp_ns = time.monotonic_ns(), cdr_stamp_ns(data)
        if self.on_output(topic, stamp_ns, now_ns):
            self._recorder.write(self._subscriptions[topic].topic_name, self._msgtypes[topic], data, stamp_ns)

    def _note(self, topic: str, data: bytes) -> None:
        msgtype, latched = _NOTES[topic]
        self._recorder.write(self._node.resolve_topic_name(topic), msgtype, data, self._sent_ns, latched)

    def _receive_diagnostics(self, message: Any) -> None:
        # A node that is never lazy reports silent inputs before the bag is played, and repeats that for a while
        played = time.monotonic() > self._played_from_s + _ERRORS_LAST_S
        for status in message.status:
            name = status.name.rpartition("/")[2]
            self._statuses[name] = status
            text = f"{name}: {status.message.splitlines()[0]}"
            silence = "nothing received" in status.message and not played
            if status.level != DiagnosticStatus.OK and not silence and text not in self._errors:
                self._errors.append(text)


def _clock_message(stamp_ns: int) -> Any:
    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(stamp_ns, 10**9)
    return message

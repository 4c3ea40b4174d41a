# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base of all nodes: parameters, diagnostics, outputs built on demand, inputs subscribed on demand."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, ClassVar

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from stereo_depth_ros.config import MatchingConfig, PairingConfig
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.core.overlap import Overlap
from stereo_depth_ros.matching import matcher_from_config
from stereo_depth_ros.nodes.diagnostics import NodeDiagnostics
from stereo_depth_ros.nodes.input import OVERRIDABLE_POLICIES, Input
from stereo_depth_ros.nodes.interface import NodeInterface, transported
from stereo_depth_ros.nodes.log import log_info
from stereo_depth_ros.nodes.message_types import RclpyTypes, message_class
from stereo_depth_ros.nodes.parameters import NodeParameters, parameters_of_ros
from stereo_depth_ros.nodes.sending import send

__all__ = ["FIRST_WAIT", "Output", "StereoNode", "log_compilation"]

_TOO_LATE = "pairs dropped while others were matched"
_INFO = "sensor_msgs/msg/CameraInfo"
_COMMAND = "std_msgs/msg/Float64"  # of these the last message counts, and there may be none
FIRST_WAIT = 4  # times queue_size: messages that may wait for the first camera infos, and then come all at once
_SILENCE_S = 5.0  # an input without a message for this time is reported
_FOLLOW_S = 0.1  # between two looks at the publishers of the inputs
_FOLLOW_ROUNDS = 5  # looks after an event


def log_compilation(node: Node, number: int, total: int) -> None:
    """Log the progress of :func:`compile_kernels`."""
    text = f"compiling kernels, {number} of {total}" if number else "waiting for another process that compiles kernels"
    log_info(node.get_logger(), text)


class Output:
    """A publisher that knows whether it has subscribers."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher

    @property
    def topic(self) -> str:
        """The resolved topic."""
        return str(self._publisher.topic_name)

    @property
    def wanted(self) -> bool:
        """True while there is a subscriber."""
        return bool(self._publisher.get_subscription_count())

    def publish(self, message: Any) -> None:
        """Publish; the memory of the message may be reused afterwards."""
        send(self._publisher, message)


class StereoNode(Node):  # type: ignore[misc]
    """A node that subscribes to its inputs while one of its outputs has a subscriber, or always if it is not lazy.

    Attributes:
        interface: its name, the types of its topics, and its configs, of which PairingConfig is one.
        matcher: name of the matcher and of what runs its network; empty without one.
        sources: what is read from files instead of a topic, for the line of the inputs in the log.
        frames: of a node whose frames overlap, see :meth:`overlap_frames`; else None.

    Raises:
        ConfigError: see :class:`NodeParameters`.
    """

    interface: ClassVar[NodeInterface]
    matcher = ""

    def __init__(self) -> None:
        with parameters_of_ros():
            super().__init__(self.interface.name)
        self.types = RclpyTypes()
        self.parameters = NodeParameters(self, *self.interface.configs)
        self.parameters.on_change = self._follow_demand
        self.diagnostics = NodeDiagnostics(self)
        self._outputs: list[Output] = []
        self._inputs: list[Input] = []
        self.sources: list[str] = []
        self.frames: Overlap[Any, Any, Any] | None = None
        self._first_frames = 0  # since the start or the last subscriber, counted as far as they may come all at once
        self.on_idle: list[Callable[[], object]] = []  # called when the last output loses its last subscriber
        self._awake = False
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_SILENCE_S, self._report_silence, clock=steady)
        self._follow_timer = self.create_timer(_FOLLOW_S, self._follow_publishers, clock=steady)
        self._follow_rounds = _FOLLOW_ROUNDS

    def add_output(self, topic: str, *, latched: bool = False) -> Output:
        """A reliable publisher of a topic of the interface; its first subscriber wakes the node.

        Of a latched one, later subscribers receive the last message.
        """
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        publisher = self.create_publisher(
            message_class(self.interface.outputs[topic]),
            topic,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST,
                depth=1 if latched else 5,
                reliability=ReliabilityPolicy.RELIABLE,
                durability=durability,
            ),
            event_callbacks=PublisherEventCallbacks(matched=lambda _: self._follow_demand()),
            qos_overriding_options=QoSOverridingOptions(OVERRIDABLE_POLICIES),
        )
        self._outputs.append(Output(publisher))
        return self._outputs[-1]

    def add_input(
        self,
        topic: str,
        callback: Callable[[Any], None],
        wanted: Callable[[], bool] = lambda: True,
        depth: int = 0,
    ) -> Input:
        """A subscription of a topic of the interface while an output and this input are needed, see :class:`Input`.

        Images are raw or compressed, by image_transport. Errors of the callback are reported. It keeps ``depth``
        messages until the callback takes them, ``queue_size`` at least.
        """
        compressed = self.parameters.get(PairingConfig).image_transport == "compressed"
        return self.add_found_input(
            *transported(topic, self.interface.inputs[topic], compressed), callback, wanted, depth
        )

    def add_found_input(
        self,
        topic: str,
        msgtype: str,
        callback: Callable[[Any], None],
        wanted: Callable[[], bool] = lambda: True,
        depth: int = 0,
    ) -> Input:
        """As :meth:`add_input`, for a topic and a type that are known only when the node runs."""
        self._inputs.append(
            Input(
                self,
                self.diagnostics,
                message_class(msgtype),
                functools.partial(self.types.deserialize, typename=msgtype),
                topic,
                callback,
                wanted,
                depth=max(depth, self.parameters.get(PairingConfig).queue_size),
                repeated=msgtype in (_INFO, _COMMAND),
                may_be_silent=msgtype == _COMMAND,
                on_change=self._start_following,
            )
        )
        self._follow_demand()
        return self._inputs[-1]

    def overlap_frames(
        self,
        prepare: Callable[[Any], Any],
        work: Callable[[Any], Any],
        publish: Callable[[Future[Any]], None],
        at_once: Callable[[Any], int],
    ) -> None:
        """Frames of :meth:`add_frame` go through these steps, see :class:`Overlap`; errors are reported."""

        def deliver(result: Future[Any]) -> None:
            with self.diagnostics.catch():
                publish(result)

        self.frames = Overlap(prepare, work, deliver, at_once)
        self.on_idle += [self.frames.drop_waiting, self._expect_burst]
        self.diagnostics.watch_loss(_TOO_LATE, _cause_of_too_late)

    def _expect_burst(self) -> None:
        self._first_frames = 0

    def add_frame(self, frame: Any) -> None:
        """Begin with a frame, now or when the ones before it are far enough; the oldest is dropped if many wait.

        Frames that have waited for the first camera infos come all at once, here or from the node before: of the first
        ones more may wait.
        """
        assert self.frames is not None  # overlap_frames comes first
        limit = self.parameters.get(PairingConfig).queue_size
        if self._first_frames < FIRST_WAIT * limit:
            self._first_frames += 1
            limit *= FIRST_WAIT
        self.diagnostics.counters[_TOO_LATE] += self.frames.add(frame, limit)

    @property
    def has_mixed_inputs(self) -> bool:
        """Whether several publishers are connected to one input, such as two cameras to one topic."""
        return any(item.publisher_count > 1 for item in self._inputs)

    def refuse_equal_topics(self, left: str, right: str) -> None:
        """Raise TopicError where both cameras were remapped to the same topic."""
        resolved = self.resolve_topic_name(left)
        if resolved == self.resolve_topic_name(right):
            raise TopicError(
                f"{left} and {right} are both {resolved}", value=resolved, remedy="remap them to different topics"
            )

    def check_matcher(self, config: MatchingConfig) -> None:
        """Compile the kernels of the matcher; raise ConfigError where it refuses its parameters."""
        matcher = matcher_from_config(config)
        self.matcher = f"{matcher.name} ({matcher.engine})" if matcher.engine else matcher.name
        compile_kernels(functools.partial(log_compilation, self))

    def readiness(self) -> list[str]:
        """Lines for the log: the inputs with their QoS, then the matcher and the outputs."""
        by_qos: dict[str, list[str]] = {}
        for topic, qos in {item.resolved_topic: item.qos_text for item in self._inputs}.items():
            by_qos.setdefault(qos, []).append(topic)
        inputs = "; ".join(f"{', '.join(topics)} ({qos})" for qos, topics in by_qos.items())
        parts = ["ready", *([f"matcher {self.matcher}"] if self.matcher else [])]
        parts.append("publishing" if self._awake else "waiting for a subscriber of")
        outputs = ", ".join(output.topic for output in self._outputs)
        inputs = "; ".join((inputs, *self.sources))
        return [f"inputs: {inputs}", f"{'; '.join(parts)} {outputs}"]

    def _follow_demand(self) -> None:
        demand = not self.interface.lazy or any(output.wanted for output in self._outputs)
        for item in self._inputs:
            wanted = demand and item.wanted()
            if wanted and not item.subscribed:
                with self.diagnostics.catch():
                    item.subscribe()
            elif not wanted and item.subscribed:
                item.unsubscribe()
        if self._awake and not demand:
            for forget in self.on_idle:
                forget()
        self._awake = demand

    def _start_following(self) -> None:
        """Look at the publishers for a while: the graph shows a change somewhat later than the event."""
        self._follow_rounds = _FOLLOW_ROUNDS
        self._follow_timer.reset()

    def _follow_publishers(self) -> None:
        for item in self._inputs:
            with self.diagnostics.catch():
                item.follow_publishers()
        self._follow_rounds -= 1
        if self._follow_rounds <= 0 and all(item.settled for item in self._inputs):
            self._follow_timer.cancel()

    def _report_silence(self) -> None:
        """Report all silent inputs in one error, by remedy; count each of them."""
        silent: dict[str, list[str]] = {}
        for item in self._inputs:
            if item.is_silent():
                self.diagnostics.counters[f"silent {item.topic}"] += 1
                topic = item.resolved_topic
                silent.setdefault(_silence_remedy(self.count_publishers(topic)), []).append(topic)
        if silent:
            groups = [
                f"{', '.join(dict.fromkeys(topics))}: nothing received for {_SILENCE_S:g} s; {remedy}"
                for remedy, topics in silent.items()
            ]
            self.diagnostics.report_error("silent inputs", ". ".join(groups))


def _cause_of_too_late() -> str:
    return (
        "pairs come faster than they are matched: lower the rate of the cameras, their size or disparity_range, or "
        "take a faster matcher"
    )


def _silence_remedy(publishers: int) -> str:
    if publishers:
        return f"{publishers} publisher(s): check their QoS and that they publish"
    return "no publisher: start the camera or remap the topic"

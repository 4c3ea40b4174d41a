# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base of all nodes: parameters, diagnostics, outputs built on demand, inputs subscribed on demand."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from stereo_depth_ros.config import MatchingConfig, PairingConfig
from stereo_depth_ros.core.errors import TopicError
from stereo_depth_ros.core.kernels import compile_kernels
from stereo_depth_ros.matching import matcher_from_config
from stereo_depth_ros.nodes.diagnostics import NodeDiagnostics
from stereo_depth_ros.nodes.message_types import RclpyTypes
from stereo_depth_ros.nodes.parameters import NodeParameters

__all__ = ["Output", "StereoNode", "log_compilation"]

_SILENCE_S = 5.0  # an input without a message for this time is reported


def log_compilation(node: Node, number: int, total: int) -> None:
    """Log the progress of :func:`compile_kernels`."""
    text = f"compiling kernels, {number} of {total}" if number else "waiting for another process that compiles kernels"
    node.get_logger().info(text)


class Output:
    """A publisher that knows whether it has subscribers."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher

    @property
    def wanted(self) -> bool:
        """True while there is a subscriber."""
        return bool(self._publisher.get_subscription_count())

    def publish(self, message: Any) -> None:
        """Publish; the memory of the message may be reused afterwards."""
        self._publisher.publish(message)


@dataclass
class _Input:
    message_type: Any
    topic: str
    callback: Callable[[Any], None]
    wanted: Callable[[], bool]
    subscription: Subscription | None = None
    received: int = 0
    received_before: int = 0


class StereoNode(Node):  # type: ignore[misc]
    """A node that subscribes to its inputs while one of its outputs has a subscriber.

    Args:
        name: node name.
        configs: config classes whose parameters it declares, besides PairingConfig.

    Raises:
        ConfigError: see :class:`NodeParameters`.
    """

    def __init__(self, name: str, *configs: type) -> None:
        super().__init__(name)
        self.types = RclpyTypes()
        self.parameters = NodeParameters(self, PairingConfig, *configs)
        self.parameters.on_change = self._follow_demand
        self.diagnostics = NodeDiagnostics(self)
        self._outputs: list[Output] = []
        self._inputs: list[_Input] = []
        self.on_idle: list[Callable[[], object]] = []  # called when the last output loses its last subscriber
        self._awake = False
        self._always_awake = False
        self.create_timer(_SILENCE_S, self._report_silence, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def add_output(self, message_type: Any, topic: str) -> Output:
        """A reliable publisher; its first subscriber wakes the node."""
        publisher = self.create_publisher(
            message_type,
            topic,
            QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=5, reliability=ReliabilityPolicy.RELIABLE),
            event_callbacks=PublisherEventCallbacks(matched=lambda _: self._follow_demand()),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._outputs.append(Output(publisher))
        return self._outputs[-1]

    def add_input(
        self,
        message_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """A best-effort subscription while an output and this input are needed; errors of the callback are reported."""
        self._inputs.append(_Input(message_type, topic, callback, wanted))

    def refuse_equal_topics(self, left: str, right: str) -> None:
        """Raise TopicError where both cameras were remapped to the same topic."""
        resolved = self.resolve_topic_name(left)
        if resolved == self.resolve_topic_name(right):
            raise TopicError(
                f"{left} and {right} are both {resolved}", value=resolved, remedy="remap them to different topics"
            )

    def check_matcher(self, config: MatchingConfig) -> None:
        """Compile the kernels of the matcher; raise ConfigError where it refuses its parameters."""
        matcher_from_config(config)
        compile_kernels(functools.partial(log_compilation, self))

    def stay_awake(self) -> None:
        """Keep the inputs subscribed without subscribers of the outputs; to be called when all of them are added."""
        self._always_awake = True
        self._follow_demand()

    def _follow_demand(self) -> None:
        demand = self._always_awake or any(output.wanted for output in self._outputs)
        for item in self._inputs:
            wanted = demand and item.wanted()
            if wanted and item.subscription is None:
                item.received_before = -1  # silence is reported after a whole interval without a message
                with self.diagnostics.catch():
                    item.subscription = self._subscribe(item)
            elif not wanted and item.subscription is not None:
                self.destroy_subscription(item.subscription)
                item.subscription = None
        if self._awake and not demand:
            for forget in self.on_idle:
                forget()
        self._awake = demand

    def _subscribe(self, item: _Input) -> Subscription:
        def receive(message: Any) -> None:
            item.received += 1
            with self.diagnostics.catch():
                item.callback(message)

        def incompatible(event: Any) -> None:
            policy, topic = qos_policy_name_from_kind(event.last_policy_kind), self.resolve_topic_name(item.topic)
            self.diagnostics.report_error(
                f"incompatible qos {item.topic}",
                f"{topic}: a publisher offers less {policy} than is requested, its messages will not be received: "
                f"change the publisher, or set qos_overrides.{topic}.subscription.{policy.lower()}",
            )

        return self.create_subscription(
            item.message_type,
            item.topic,
            receive,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST,
                depth=self.parameters.get(PairingConfig).queue_size,
                reliability=ReliabilityPolicy.BEST_EFFORT,
            ),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=incompatible),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _report_silence(self) -> None:
        for item in self._inputs:
            if item.subscription is not None and item.received == item.received_before:
                topic = self.resolve_topic_name(item.topic)
                publishers = self.count_publishers(topic)
                remedy = (
                    f"{publishers} publisher(s): check their QoS and that they publish"
                    if publishers
                    else "no publisher: start the camera or remap the topic"
                )
                self.diagnostics.report_error(
                    f"silent {item.topic}", f"{topic}: nothing received for {_SILENCE_S:g} s; {remedy}"
                )
            item.received_before = item.received

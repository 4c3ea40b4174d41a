# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: parameters, health, outputs that are made on demand, inputs that exist only then."""

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

_SILENCE_S = 5.0  # after this time without a message on an input, the node says so


def log_compilation(node: Node, number: int, total: int) -> None:
    """Log that a kernel is compiled, as :func:`compile_kernels` reports it."""
    node.get_logger().info(f"compiling kernels, {number} of {total}")


class Output:
    """A publisher and whether anybody wants its messages."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher

    @property
    def wanted(self) -> bool:
        """True while there is a subscriber."""
        return bool(self._publisher.get_subscription_count())

    def publish(self, message: Any) -> None:
        """Send; the message's memory may be used again afterwards."""
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
    """A node that subscribes to its inputs while somebody subscribes to one of its outputs.

    Args:
        name: node name.
        configs: config classes whose parameters it declares; PairingConfig is always one of them.

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
        self.on_idle: list[Callable[[], object]] = []  # called when no output is wanted any more
        self._awake = False
        self._sleepless = False
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
        """A best-effort subscription while an output, and it, is wanted; errors of the callback become complaints."""
        self._inputs.append(_Input(message_type, topic, callback, wanted))

    def refuse_equal_topics(self, left: str, right: str) -> None:
        """Raise TopicError where both cameras were remapped to the same topic."""
        resolved = self.resolve_topic_name(left)
        if resolved == self.resolve_topic_name(right):
            raise TopicError(f"{left} and {right} are both {resolved}: remap them to different topics")

    def check_matcher(self, config: MatchingConfig) -> None:
        """Raise ConfigError where the matcher refuses its parameters; its kernels are ready then."""
        matcher_from_config(config)
        compile_kernels(functools.partial(log_compilation, self))

    def stay_awake(self) -> None:
        """Keep the inputs subscribed whoever listens; to be called when all of them are added."""
        self._sleepless = True
        self._follow_demand()

    def _follow_demand(self) -> None:
        demand = self._sleepless or any(output.wanted for output in self._outputs)
        for item in self._inputs:
            wanted = demand and item.wanted()
            if wanted and item.subscription is None:
                item.received_before = -1  # silence is told after a whole interval without a message
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
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self.diagnostics.report_error(
                f"incompatible qos {item.topic}",
                f"{self.resolve_topic_name(item.topic)}: a publisher offers less {policy} than is asked for, nothing "
                f"will arrive from it: change the publisher, or set qos_overrides.{self.resolve_topic_name(item.topic)}"
                f".subscription.{policy.lower()}",
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
                    f"{publishers} publisher(s) are there: check their QoS and that they send"
                    if publishers
                    else "nobody publishes it: start the camera or remap the topic"
                )
                self.diagnostics.report_error(
                    f"silent {item.topic}", f"{topic}: nothing received for {_SILENCE_S:g} s; {remedy}"
                )
            item.received_before = item.received

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An input of a node: subscribed while it is wanted, with the QoS that the publishers of its topic offer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.nodes.diagnostics import NodeDiagnostics

__all__ = ["OVERRIDABLE_POLICIES", "Input"]

OVERRIDABLE_POLICIES = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)


class Input:
    """A subscription that follows the demand of its node and the publishers of its topic.

    It is reliable while every publisher is, and best effort where one is not. A topic of repeated messages, a camera
    info, is best effort: on a reliable subscription the repetitions wait for one that was lost, up to a second where
    images fill the transport of a driver. Where a publisher latches it, a transient local subscription receives what
    was published before; it is a second one, because it receives nothing from those that do not latch, and what both
    receive is handed on twice. The parameters qos_overrides.<topic>.subscription.<policy> win.

    Args:
        node: subscribes.
        diagnostics: of the node; errors of the callback are reported there, lost messages counted.
        message_type: class of the messages.
        deserialize: message from CDR bytes; raises MessageError. Where rclpy does it, a message that cannot be read is
            lost without a word, but for a line on stderr for each.
        topic: relative to the namespace of the node.
        callback: called with every message.
        wanted: whether the node needs this input.
        depth: messages kept until the callback takes them.
        repeated: whether only the last message counts, which may be latched; one may be received twice.
        may_be_silent: whether it is normal that no message comes.
        on_change: called when a publisher appears or goes away, some time before the graph shows it.
    """

    def __init__(
        self,
        node: Node,
        diagnostics: NodeDiagnostics,
        message_type: Any,
        deserialize: Callable[[bytes], Any],
        topic: str,
        callback: Callable[[Any], None],
        wanted: Callable[[], bool],
        depth: int,
        repeated: bool,
        may_be_silent: bool,
        on_change: Callable[[], None],
    ) -> None:
        self.topic = topic
        self.wanted = wanted
        self._node = node
        self._diagnostics = diagnostics
        self._message_type = message_type
        self._deserialize = deserialize
        self._callback = callback
        self._depth = depth
        self._repeated = repeated
        self._may_be_silent = may_be_silent
        self._on_change = on_change
        self._received, self._received_before = 0, 0  # now, and when it was looked at last
        self._subscription: Subscription | None = None
        # Of the subscription; a reliable publisher that starts later has its first message received, a best-effort one
        # is followed after it.
        self._reliability = ReliabilityPolicy.BEST_EFFORT if repeated else ReliabilityPolicy.RELIABLE
        self._former: Subscription | None = None  # until the one that replaces it is connected
        self._latched: Subscription | None = None
        self._sent_at: deque[int] = deque(maxlen=2 * depth)  # of the last messages, by the clock of their publisher
        self._may_repeat = 0  # messages that both subscriptions may have received, at most
        self._number: int | None = None  # that DDS has given to the newest message
        self._missed = 0  # numbers that did not arrive
        if not repeated:
            diagnostics.watch_loss(f"lost {topic}", self._cause_of_loss)
            diagnostics.watch_loss(f"replaced {topic}", self._cause_of_replacement)
            diagnostics.watch_state(self._mixture)

    @property
    def resolved_topic(self) -> str:
        """The full name of the topic."""
        return str(self._node.resolve_topic_name(self.topic))

    @property
    def subscribed(self) -> bool:
        """Whether it is subscribed."""
        return self._subscription is not None

    @property
    def publisher_count(self) -> int:
        """Publishers that are connected now."""
        return 0 if self._subscription is None else int(self._subscription.get_publisher_count())

    @property
    def settled(self) -> bool:
        """Whether no change of the subscription is under way."""
        return self._former is None

    @property
    def qos_text(self) -> str:
        """Reliability and depth, as the user may have overridden them."""
        overrides = self._overrides()
        following = "best effort unless latched" if self._repeated else "reliable as its publishers"
        reliability = str(overrides.get("reliability", following)).replace("_", " ")
        return f"{reliability}, depth {overrides.get('depth', self._depth)}"

    def subscribe(self) -> None:
        """Subscribe, with the QoS of the publishers known so far.

        Raises:
            rclpy's errors for an override that is not a policy.
        """
        self._received_before = -1  # not silent before a whole interval has passed
        self._reliability, is_latched = self._publishers_offer()
        self._subscription = self._create(self._reliability)
        self._follow_latching(is_latched)

    def take_waiting(self) -> None:
        """Call the callback with the messages that wait in the subscription, before the executor does."""
        for subscription in self._subscriptions():
            while True:
                with subscription.handle:
                    taken = subscription.handle.take_message(self._message_type, True)
                if taken is None:
                    break
                self._receive(*taken)

    def is_silent(self) -> bool:
        """Whether it should have received something since the last call; the first call begins the interval."""
        before, self._received_before = self._received_before, self._received
        return self.subscribed and self._received == before and not self._may_be_silent

    def unsubscribe(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions():
            self._node.destroy_subscription(subscription)
        self._former = self._subscription = self._latched = None
        self._may_repeat = 0
        self._number = None
        self._sent_at.clear()

    def follow_publishers(self) -> None:
        """Subscribe again where the publishers offer another QoS than before; nothing is lost on the way."""
        if self._subscription is None:
            return
        if self._former is not None:
            if self._subscription.get_publisher_count() >= self._former.get_publisher_count():
                self._node.destroy_subscription(self._former)
                self._former, self._may_repeat = None, 2 * self._depth
            return
        reliability, is_latched = self._publishers_offer()
        self._follow_latching(is_latched)
        if reliability != self._reliability:
            self._reliability, self._former = reliability, self._subscription
            self._subscription = self._create(reliability)

    def _subscriptions(self) -> list[Subscription]:
        return [found for found in (self._former, self._subscription, self._latched) if found is not None]

    def _publishers_offer(self) -> tuple[ReliabilityPolicy, bool]:
        """The reliability to request, which all publishers offer, and whether one latches what is repeated.

        Those of now while there is no publisher.
        """
        profiles = [info.qos_profile for info in self._node.get_publishers_info_by_topic(self.resolved_topic)]
        if self._repeated:
            known = any(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
            return ReliabilityPolicy.BEST_EFFORT, known if profiles else self._latched is not None
        if not profiles:
            return self._reliability, False
        reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
        return ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT, False

    def _follow_latching(self, is_latched: bool) -> None:
        """Subscribe to what publishers latch, and end it; the user's durability is enough where there is one."""
        if is_latched and self._latched is None and "durability" not in self._overrides():
            self._latched = self._create(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
        elif not is_latched and self._latched is not None:
            self._node.destroy_subscription(self._latched)
            self._latched = None

    def _overrides(self) -> dict[str, Any]:
        """The values that the user has set, by name of the policy."""
        prefix = f"qos_overrides.{self.resolved_topic}.subscription."
        found = self._node._parameter_overrides
        names = [kind.name.lower() for kind in OVERRIDABLE_POLICIES]
        return {name: found[prefix + name].value for name in names if prefix + name in found}

    def _create(
        self, reliability: ReliabilityPolicy, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    ) -> Subscription:
        # Only what the user has set: rclpy keeps the first value of a policy, and ours may change.
        overridden = [kind for kind in OVERRIDABLE_POLICIES if kind.name.lower() in self._overrides()]
        return self._node.create_subscription(
            self._message_type,
            self.topic,
            self._receive,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST, depth=self._depth, reliability=reliability, durability=durability
            ),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=self._on_incompatible,
                matched=self._on_matched,
                message_lost=self._on_lost,
            ),
            qos_overriding_options=QoSOverridingOptions(overridden),
            raw=True,
        )

    def _receive(self, data: bytes, info: Mapping[str, Any]) -> None:
        with self._diagnostics.catch():
            sent_at = info["source_timestamp"]
            is_repeated = (self._former is not None or self._may_repeat > 0) and sent_at in self._sent_at
            self._may_repeat = max(0, self._may_repeat - 1)
            self._sent_at.append(sent_at)
            if not is_repeated:
                self._received += 1
                self._note_number(info["publication_sequence_number"])
                self._callback(self._read(data))

    def _read(self, data: bytes) -> Any:
        try:
            return self._deserialize(data)
        except MessageError as error:
            raise error.about(self.resolved_topic) from error

    def _note_number(self, number: int | None) -> None:
        """Count what did not arrive and was not lost on the way: newer messages replaced it in the queue.

        DDS numbers the messages of a publisher without gaps; not every middleware tells the number.
        """
        if self._repeated or number is None or self.publisher_count != 1:
            self._number = None
            return
        if self._number is not None:
            self._missed = max(0, self._missed + (number - self._number - 1 if number > self._number else -1))
        self._number = number if self._number is None else max(number, self._number)
        counters = self._diagnostics.counters
        counters[f"replaced {self.topic}"] = max(0, self._missed - counters[f"lost {self.topic}"])

    def _mixture(self) -> str:
        """What is wrong where several nodes publish the topic; empty where one does."""
        if not self.subscribed:
            return ""
        publishers = self._node.get_publishers_info_by_topic(self.resolved_topic)
        if len(publishers) < 2:
            return ""
        names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in publishers)
        return (
            f"{self.resolved_topic} has {len(names)} publishers, {', '.join(names[:-1])} and {names[-1]}, and their "
            "images are mixed: stop or remap one"
        )

    def _on_matched(self, event: Any) -> None:
        self._number = None  # another publisher counts anew
        self._on_change()

    def _on_lost(self, event: Any) -> None:
        self._diagnostics.counters[f"lost {self.topic}"] += event.total_count_change

    def _cause_of_loss(self) -> str:
        topic = self.resolved_topic
        if self._reliability == ReliabilityPolicy.RELIABLE:
            return f"{topic} is reliable, and its publisher keeps too few images: lower its rate, or raise its depth"
        return (
            f"{topic} is best effort, and what finds no room in transit is gone: publish it reliably, or give its "
            "publisher more shared memory, as config/fastdds.xml does"
        )

    def _cause_of_replacement(self) -> str:
        return (
            f"{self.resolved_topic} arrives faster than this node takes it, and newer messages replaced older ones: "
            f"lower its rate, choose a faster matcher, or raise queue_size ({self._depth})"
        )

    def _on_incompatible(self, event: Any) -> None:
        self._on_change()
        policy, topic = qos_policy_name_from_kind(event.last_policy_kind), self.resolved_topic
        if policy.lower() not in self._overrides():
            return  # the subscription follows
        self._diagnostics.report_error(
            f"incompatible qos {self.topic}",
            f"{topic}: a publisher offers less {policy} than is requested, its messages will not be received: "
            f"change the publisher, or set qos_overrides.{topic}.subscription.{policy.lower()}",
        )

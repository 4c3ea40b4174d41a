# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images that belong to frames of other topics: whatever comes first, and what is dropped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from stereo_depth_ros.nodes.followed_images import FollowedImages

KEPT = 30


class Inputs:
    """A node that only keeps what is subscribed."""

    def __init__(self) -> None:
        self.receive: dict[str, Callable[[Any], None]] = {}
        self.on_idle: list[Callable[[], object]] = []
        self.losses: dict[str, str] = {}
        self.counters: Counter[str] = Counter()
        self.diagnostics = SimpleNamespace(
            counters=self.counters, watch_loss=lambda name, cause: self.losses.update({name: cause()})
        )

    def resolve_topic_name(self, topic: str) -> str:
        return f"/robot/{topic}"

    def add_found_input(self, topic: str, msgtype: str, callback: Callable[[Any], None], wanted: Any) -> None:
        assert msgtype == "sensor_msgs/msg/Image"
        self.receive[topic] = callback


def image(stamp: int) -> Any:
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=stamp, nanosec=7)))


def stamp_ns(stamp: int) -> int:
    return stamp * 10**9 + 7


def followed() -> tuple[Inputs, FollowedImages, list[Any]]:
    node, delivered = Inputs(), []
    images: Any = FollowedImages(
        node,  # type: ignore[arg-type]
        ("a", "b"),
        lambda: True,
        lambda frame, found: delivered.append((frame, found)),
    )
    return node, images, delivered


def test_a_frame_is_delivered_with_its_images_in_any_order() -> None:
    node, images, delivered = followed()
    first, second, third = image(1), image(1), image(2)
    node.receive["b"](second)
    images.add(stamp_ns(1), "one")
    images.add(stamp_ns(2), "two")
    node.receive["a"](third)
    assert delivered == []
    node.receive["a"](first)
    assert delivered == [("one", [first, second])]
    fourth = image(2)
    node.receive["b"](fourth)
    assert delivered[1:] == [("two", [third, fourth])]
    assert not node.counters


def test_frames_without_images_are_counted_with_a_cause() -> None:
    node, images, delivered = followed()
    for stamp in range(KEPT + 3):
        node.receive["a"](image(stamp))
        images.add(stamp_ns(stamp), stamp)
    name = "frames without /robot/a and /robot/b"
    assert node.counters == {name: 3}
    assert "missing or has other stamps" in node.losses[name]
    for stamp in range(KEPT + 3):
        node.receive["b"](image(stamp))
    assert [frame for frame, _ in delivered] == [*range(3, KEPT + 3)]


def test_an_idle_node_forgets_what_waits() -> None:
    node, images, delivered = followed()
    images.add(stamp_ns(1), "one")
    node.on_idle[0]()
    node.receive["a"](image(1))
    node.receive["b"](image(1))
    assert delivered == [] and not node.counters

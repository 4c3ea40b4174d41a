# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The player repeats the first pair where a link between nodes was late: nodes that have it already must forget it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="the player is part of a node")

from stereo_bags import write_odd_bag

from stereo_depth_ros.bags.pairs import BagPairs, BagSelection, SerializedPair
from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.nodes.replay import player
from stereo_depth_ros.replay.options import ReplayOptions


class LateLink:
    """Ports to a graph of two nodes: what the first one made of the first pair did not reach the second one.

    It makes nothing of a pair again unless it was without a subscriber.
    """

    output_topics = ("disparity", "points2")

    def __init__(self) -> None:
        self.on_output: Any = None
        self.steps: list[str] = []
        self._known: set[int] = set()
        self._linked = False

    def record_infos(self, pair: SerializedPair) -> None:
        pass

    def send_all_but_last(self, pair: SerializedPair) -> None:
        self.steps.append("sent")

    def send_last(self, pair: SerializedPair) -> None:
        if pair.stamp_ns in self._known:
            return
        self._known.add(pair.stamp_ns)
        self.on_output("disparity", pair.stamp_ns, 1)
        if self._linked:
            self.on_output("points2", pair.stamp_ns, 1)
        self._linked = True

    def subscribe_again(self) -> None:
        self.steps.append("idle")
        self._known.clear()

    def spin(self, timeout_s: float) -> None:
        pass

    def obstacles(self) -> list[str]:
        return []

    def count_endpoints(self) -> int:
        return 1


def test_nodes_that_have_the_first_pair_forget_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(player, "_REPEAT_S", 0.01)
    monkeypatch.setattr(player, "_SETTLED_S", 0.01)
    write_odd_bag(tmp_path / "in.mcap", 2)
    ports: Any = LateLink()
    with BagPairs(BagSelection(tmp_path / "in.mcap"), PairingConfig()) as pairs:
        options = ReplayOptions(bag=str(tmp_path / "in.mcap"), output=str(tmp_path / "out.mcap"))
        played = player.Player(ports, pairs, options, approximate=False, check=lambda: None)
        played.play(lambda sent, total: None)
    assert played.sent == 2 and not played.lost
    assert ports.steps == ["sent", "sent", "idle", "sent", "sent"]

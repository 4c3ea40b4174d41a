# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options of a replay, which are the parameters of the replay node."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.config import parameter_infos
from stereo_depth_ros.config.view_topics import check_views
from stereo_depth_ros.core.errors import ConfigError

__all__ = ["ReplayOptions"]


def _option(default: bool | int | float | str, doc: str, **info: Any) -> Any:
    return field(default=default, metadata={"doc": doc, "run_time": False, **info})


@dataclass(frozen=True)
class ReplayOptions:
    """The bag to play, the part of it, and how it is played.

    Raises:
        ConfigError: a wrong type, a value out of range, no bag, or an unknown view.
    """

    bag: str = _option("", "Bag to play: .mcap, .db3, .bag of ROS 1, a rosbag2 folder.")
    output: str = _option("", "MCAP bag to record the outputs into; empty records nothing.")
    overwrite: bool = _option(False, "Replace the output where it exists.")
    rate: float = _option(
        0.0,
        "Rate relative to that of the bag; 0 is the maximum rate of the graph (with realtime: 1).",
        low=0.0,
        high=1000.0,
    )
    realtime: bool = _option(False, "Publish in real time without waiting for the graph.")
    clock: bool = _option(False, "Publish the stamps of the pairs on /clock.")
    loop: int = _option(1, "Number of times that the bag is played; stamps keep increasing.", low=1, high=1_000_000)
    start_seconds: float = _option(
        0.0, "Where to begin, after the first message of the bag.", low=0.0, high=1e9, unit="s"
    )
    duration_seconds: float = _option(0.0, "How much to play; 0 plays to the end.", low=0.0, high=1e9, unit="s")
    left_topic: str = _option("", "Left image topic in the bag; empty finds it.")
    right_topic: str = _option("", "Right image topic in the bag; empty finds it.")
    side_by_side: bool = _option(False, "Both images are in one topic, the left one in the left half.")
    in_flight: int = _option(1, "Maximum number of pairs in the graph at one time.", low=1, high=100)
    views: str = _option("", "Views of view_node to record too, separated by commas, such as anaglyph.")
    strict: bool = _option(False, "End with an error where the first pairs do not fit the calibration.")

    def __post_init__(self) -> None:
        for info in parameter_infos(self):
            object.__setattr__(self, info.field, info.check(getattr(self, info.field)))
        if not self.bag:
            raise ConfigError(
                "parameter bag is empty", value="", remedy="set it to the path of a bag", settings=("bag",)
            )
        check_views(self.view_topics)

    @property
    def view_topics(self) -> tuple[str, ...]:
        """The views that are recorded."""
        return tuple(filter(None, (topic.strip() for topic in self.views.split(","))))

    @property
    def selection(self) -> BagSelection:
        """The part of the bag that is read."""
        return BagSelection(
            Path(self.bag),
            self.left_topic or None,
            self.right_topic or None,
            self.start_seconds,
            self.duration_seconds,
            self.side_by_side,
        )

    @property
    def output_path(self) -> Path | None:
        """The bag to record; None for no recording."""
        return Path(self.output) if self.output else None

    @property
    def speed(self) -> float:
        """Rate relative to that of the bag at which pairs become due; 0 makes them due immediately."""
        return self.rate or (1.0 if self.realtime else 0.0)

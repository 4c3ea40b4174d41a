# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How a bag is played: the parameters of the replay node and the options of `stereo-depth replay`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.config import parameter_infos
from stereo_depth_ros.core.errors import ConfigError

__all__ = ["ReplayOptions"]


def _option(default: bool | int | float | str, doc: str, **info: Any) -> Any:
    return field(default=default, metadata={"doc": doc, **info})


@dataclass(frozen=True)
class ReplayOptions:
    """What is played, and how.

    Raises:
        ConfigError: a value of another type or out of range, or no bag.
    """

    bag: str = _option("", "Bag to play: .mcap, .db3, a rosbag2 folder.")
    output: str = _option("", "MCAP bag to record the outputs into; empty records nothing.")
    overwrite: bool = _option(False, "Replace the output where it exists.")
    rate: float = _option(
        0.0,
        "Speed of sending, times the bag's own; 0 is as fast as the graph is ready (with realtime: 1).",
        low=0.0,
        high=1000.0,
    )
    realtime: bool = _option(False, "Send by the clock and do not wait for the graph.")
    clock: bool = _option(False, "Publish the time of the pairs on /clock.")
    loop: int = _option(1, "How often the bag is played; later rounds are stamped later.", low=1, high=1_000_000)
    start_seconds: float = _option(0.0, "Where to begin, after the bag's first message.", low=0.0, high=1e9, unit="s")
    duration_seconds: float = _option(0.0, "How much to play; 0 is all.", low=0.0, high=1e9, unit="s")
    left_topic: str = _option("", "Left image topic in the bag; empty finds it.")
    right_topic: str = _option("", "Right image topic in the bag; empty finds it.")
    in_flight: int = _option(1, "Pairs that may be on their way through the graph.", low=1, high=100)

    def __post_init__(self) -> None:
        for info in parameter_infos(self):
            object.__setattr__(self, info.field, info.check(getattr(self, info.field)))
        if not self.bag:
            raise ConfigError("parameter bag is empty: set it to the path of a bag, for example bag:=drive.mcap")

    @property
    def selection(self) -> BagSelection:
        """The part of the bag that is read."""
        return BagSelection(
            Path(self.bag),
            self.left_topic or None,
            self.right_topic or None,
            self.start_seconds,
            self.duration_seconds,
        )

    @property
    def output_path(self) -> Path | None:
        """Where the outputs are recorded; None for nowhere."""
        return Path(self.output) if self.output else None

    @property
    def speed(self) -> float:
        """Times the bag's own speed at which pairs become due; 0 is at once."""
        return self.rate or (1.0 if self.realtime else 0.0)

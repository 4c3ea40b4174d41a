# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Computes depth from patterns of a projector: collects the images of a sequence of patterns, then publishes."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from stereo_depth_ros.active.scanner import Capture, Scanner, by_changes, settling
from stereo_depth_ros.active.shown_patterns import ShownPatterns, read_patterns
from stereo_depth_ros.active.structured_light.collecting import AnnouncedPatterns, ChangingPatterns
from stereo_depth_ros.config import (
    CameraInfoConfig,
    CloudConfig,
    DepthConfig,
    PairingConfig,
    PipelineConfig,
    StructuredLightConfig,
)
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RAW_IMAGES, NodeInterface
from stereo_depth_ros.nodes.log import log_info
from stereo_depth_ros.nodes.message_types import message_class
from stereo_depth_ros.nodes.pair_input import PairInput, check_side, decode_from
from stereo_depth_ros.nodes.runner import run
from stereo_depth_ros.nodes.triggers import add_trigger
from stereo_depth_ros.outputs import OUTPUTS, ResultMessages

__all__ = ["StructuredLightNode", "main"]

_NUMBER = "std_msgs/msg/Int32"
_CAUSE_OF_INCOMPLETE = "the first pattern came again, or the calibration changed, before the last one"


class StructuredLightNode(StereoNode):
    """Two cameras see the patterns of `stereo-depth patterns`, or one camera beside a calibrated projector.

    scan/wanted has the number of the first pattern that is missing, from 0: a program that shows this one, and then
    says so on scan/shown or by ~/next, drives the projector. When all are there, the outputs are published, latched.
    ~/restart begins again.
    """

    interface = NodeInterface(
        "structured_light_node",
        configs=(PairingConfig, CameraInfoConfig, StructuredLightConfig, DepthConfig, CloudConfig),
        inputs=CAMERA_INFOS | RAW_IMAGES | {"scan/shown": _NUMBER},
        outputs={row.topic: row.msgtype for row in OUTPUTS} | {"scan/wanted": _NUMBER},
        services={f"~/{name}": "std_srvs/srv/Trigger" for name in ("next", "restart")},
        lazy=False,
    )

    def __init__(self) -> None:
        super().__init__()
        config = self.parameters.get(StructuredLightConfig)
        self._patterns = _patterns(config)
        count = len(self._patterns)
        settle = settling(self._patterns, config.settle_frames)
        self._announced: AnnouncedPatterns[Capture] = AnnouncedPatterns(count, settle)
        self._changing: ChangingPatterns[Capture] | None = None
        if config.pattern_signal == "images":
            self._changing = by_changes(self._patterns, settle)
        self._collector = self._changing or self._announced
        self._scanner_of = functools.lru_cache(maxsize=1)(self._make_scanner)
        self._messages = ResultMessages(self.types)
        self._results = [(self.add_output(row.topic, latched=True), row.build) for row in OUTPUTS]
        self._wanted = self.add_output("scan/wanted", latched=True)
        self._calibration = CalibrationInput(self)
        if config.projector:
            self.add_input("left/image_raw", self._on_image)
        else:
            self.refuse_equal_topics("left/image_raw", "right/image_raw")
            self._pairs = PairInput(self, "left/image_raw", "right/image_raw", self._on_pair)
            self.add_input("left/image_raw", self._pairs.add_left)
            self.add_input("right/image_raw", self._pairs.add_right)
        if config.pattern_signal == "topic":
            self.add_input("scan/shown", self._on_shown)
        add_trigger(self, "~/next", self._next)
        add_trigger(self, "~/restart", self._restart)
        self.diagnostics.watch_loss("incomplete scans", lambda: _CAUSE_OF_INCOMPLETE)
        self.diagnostics.watch_state(self._no_sequence)
        self._report()

    def _on_pair(self, left: Any, right: Any) -> None:
        self._calibration.with_rig(functools.partial(self._add_pair, left, right), left, right)

    def _add_pair(self, left: Any, right: Any, rig: StereoRig) -> None:
        self._pairs.check(left, right, rig)
        pair = self._pairs.decode(left, right)
        self._add((pair.left, pair.right), rig)

    def _on_image(self, message: Any) -> None:
        self._calibration.with_rig(functools.partial(self._add_image, message), message)

    def _add_image(self, message: Any, rig: StereoRig) -> None:
        check_side(self, "left", "left/image_raw", message, rig)
        self._add((decode_from(self, "left/image_raw", message),), rig)

    def _add(self, capture: Capture, rig: StereoRig) -> None:
        self._collector.settle = settling(self._patterns, self.parameters.get(StructuredLightConfig).settle_frames)
        complete = self._collector.add(capture, rig)
        self.diagnostics.counters["captures"] += 1
        if complete is not None:
            self._publish(complete, rig)
        self._report()

    def _publish(self, captures: list[Capture], rig: StereoRig) -> None:
        result = self._scanner_of(rig).scan(captures)
        for output, build in self._results:
            output.publish(build(self._messages, result))
        self.diagnostics.timing(result.timings_ms)
        self.diagnostics.counters["scans"] += 1
        log_info(self.get_logger(), f"scan complete: {result.disparity.valid_fraction:.1%} of the pixels have a depth")

    def _make_scanner(self, rig: StereoRig) -> Scanner:
        get = self.parameters.get
        return Scanner(PipelineConfig(depth=get(DepthConfig), cloud=get(CloudConfig)), rig, self._patterns)

    def _on_shown(self, message: Any) -> None:
        self._announced.show(message.data)

    def _next(self) -> str:
        signal = self.parameters.get(StructuredLightConfig).pattern_signal
        if signal != "service":
            raise ConfigError(
                f"pattern_signal is {signal}, patterns are not announced by this service",
                value=signal,
                limit="service",
                remedy="start the node with pattern_signal:=service",
            )
        number = self._announced.missing[0]
        self._announced.show(number)
        return f"pattern {number} of 0 to {len(self._patterns) - 1}, {self._patterns.name(number)}: images awaited"

    def _restart(self) -> str:
        self._collector.restart()
        self._report()
        return "begun again: all patterns are missing"

    def _no_sequence(self) -> str:
        count, seen = len(self._patterns), self._changing.seen if self._changing else 0
        if seen <= 2 * count or self._changing is None:
            return ""
        return f"{seen} different images, and no {count} of them in a row are the sequence: {self._changing.fault}"

    def _report(self) -> None:
        """On scan/wanted and /diagnostics."""
        self.diagnostics.counters["incomplete scans"] = self._collector.abandoned
        count = len(self._patterns)
        if self._changing is not None:
            self.diagnostics.facts = {"patterns": f"{min(self._changing.seen, count)} of {count} seen"}
            return
        missing = self._announced.missing
        names = ", ".join(f"{number} ({self._patterns.name(number)})" for number in missing[:3])
        self.diagnostics.facts = {"patterns": f"{count - len(missing)} of {count} taken", "missing": names}
        self._wanted.publish(message_class(_NUMBER)(data=missing[0]))


def _patterns(config: StructuredLightConfig) -> ShownPatterns:
    if not config.patterns:
        raise ConfigError(
            "no patterns are named",
            subject="structured_light_node",
            value="",
            remedy="name the patterns.json that `stereo-depth patterns` writes",
            settings=("patterns",),
        )
    return read_patterns(Path(config.patterns).expanduser())


def main() -> int:
    """Run the node."""
    return run(StructuredLightNode)


if __name__ == "__main__":
    raise SystemExit(main())

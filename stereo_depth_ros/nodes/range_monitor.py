# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks published disparities against a range sensor of the live graph."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from stereo_depth_ros.calibration.range_check import Figure, RangeCheck, RangeChecker
from stereo_depth_ros.config import CalibrationMonitorConfig
from stereo_depth_ros.core.errors import TransformError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.messages.disparity import matched_disparity
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput
from stereo_depth_ros.nodes.placed_sweeps import PlacedSweeps

__all__ = ["RangeMonitor"]

_WAITING = 3  # disparities that wait for their sweep
_LEAST_NS = 10**9  # between two comparisons: one takes some ten milliseconds
_NOT_OBSERVABLE = "not observable"
# name of each figure in the diagnostics, unit, factor, format
_SHOWN = {
    "scale": ("baseline scale", "%", 100.0, "+.2f"),
    "offset": ("disparity offset", "px", 1.0, "+.3f"),
    "pitch": ("sensor pitch", "deg", 1.0, "+.3f"),
    "yaw": ("sensor yaw", "deg", 1.0, "+.3f"),
    "roll": ("sensor roll", "deg", 1.0, "+.3f"),
}


class RangeMonitor:
    """Compares each disparity image with the nearest sweep of the sensor.

    Args:
        node: subscribes disparity, the sensor, /tf_static and /tf; its config names the topic.
        calibration: gives the rig of a disparity image.
        on_result: called after each comparison, and when something new is missing.
    """

    def __init__(self, node: StereoNode, calibration: CalibrationInput, on_result: Callable[[], None]) -> None:
        config = node.parameters.get(CalibrationMonitorConfig)
        self._node, self._calibration, self._on_result = node, calibration, on_result
        self._sweeps = PlacedSweeps(
            node, config.range_sensor, config.range_sensor_extrinsics, "range_sensor_extrinsics", self._on_sweep
        )
        self._waiting: deque[tuple[Any, StereoRig]] = deque(maxlen=_WAITING)
        self._checker: tuple[StereoRig, RangeChecker] | None = None
        self._found: RangeCheck | None = None
        self._missing = ""
        self._taken_ns = -math.inf
        node.add_input("disparity", self._on_disparity)

    @property
    def facts(self) -> dict[str, str]:
        """The figures by name, for the diagnostics."""
        sensor = self._sweeps.sensor
        facts = {"range sensor": f"{sensor.topic} {sensor.msgtype or 'without a publisher'}"}
        if self._found is None:
            return facts
        for name, figure in self._found.figures.items():
            title, unit, factor, form = _SHOWN[name]
            facts[f"{title} {unit}"] = (
                f"{factor * figure.value:{form}} +- {factor * figure.sigma:{form[1:]}}"
                if figure.observable
                else _NOT_OBSERVABLE
            )
        facts["range points"] = f"{self._found.matched} of {self._found.points} agree in {self._found.pairs} pairs"
        return facts | {"range residual px": f"{self._found.residual_px:.3f}"}

    @property
    def warnings(self) -> list[str]:
        """What is missing or wrong, a sentence each."""
        return [self._missing] if self._missing else list(_deviations(self._found))

    def _on_sweep(self) -> None:
        counters = self._node.diagnostics.counters
        if not counters["sweeps"]:  # the type of the sensor is known now
            self._on_result()
        counters["sweeps"] += 1
        self._compare_waiting()

    def _on_disparity(self, message: Any) -> None:
        now_ns, rate = stamp_ns(message.header), self._node.parameters.get(CalibrationMonitorConfig).health_rate
        if not rate or not 0 <= now_ns - self._taken_ns < max(1e9 / rate, _LEAST_NS):
            self._taken_ns = now_ns
            self._calibration.with_rig(lambda rig: self._add(message, rig), message)

    def _add(self, message: Any, rig: StereoRig) -> None:
        if len(self._waiting) == _WAITING:
            self._node.diagnostics.counters["disparities without a sweep in time"] += 1
        self._waiting.append((message, rig))
        self._compare_waiting()

    def _compare_waiting(self) -> None:
        """Compare the disparities whose sweep and transforms are there; those that wait too long are reported."""
        if not len(self._sweeps):
            return
        waiting, missing = list(self._waiting), ""
        self._waiting.clear()
        for message, rig in waiting:
            try:
                is_done = self._compare(message, rig)
            except TransformError as error:  # which may arrive later
                is_done, missing = False, self._sweeps.missing(error)
            if not is_done:
                self._waiting.append((message, rig))
        if missing and len(self._waiting) < _WAITING:
            return
        if missing != self._missing:
            self._missing = missing
            self._on_result()

    def _compare(self, message: Any, rig: StereoRig) -> bool:
        """Compare with the nearest sweep; False where it is not in time."""
        at_ns = stamp_ns(message.header)
        sweep = self._sweeps.in_time(rig, at_ns)
        if sweep is None:
            return False
        disparity_px = matched_disparity(message, rig, self._node.resolve_topic_name("disparity"))
        with self._node.diagnostics.timed("range check"):
            points, seen = self._sweeps.project(sweep, rig, at_ns)
            if self._checker is None or self._checker[0] is not rig:
                self._checker = rig, RangeChecker(Triangulation.from_rig(rig))
            self._checker[1].add(disparity_px, points[seen.index[seen.index >= 0]])
            self._found = self._checker[1].check()
        counters = self._node.diagnostics.counters
        counters["range points hidden to the camera"] += seen.occluded
        counters["range points outside of the image"] += seen.outside + seen.behind
        counters["disparities compared"] += 1
        self._on_result()
        return True


def _deviations(found: RangeCheck | None) -> Iterator[str]:
    """A sentence for what is above its limit and above three standard deviations, with what to do."""
    if found is None:
        return
    if found.scale.deviates:
        yield (
            f"the baseline differs by {_text(found.scale, 100, '%', 2)} from the calibrated one by the range sensor: "
            "calibrate the cameras again, or correct the size of the squares of the board"
        )
    if found.offset.deviates:
        yield (
            f"disparities are too large by {_text(found.offset, 1, 'px', 2)} by the range sensor: the cameras have "
            "turned against each other, calibrate them again"
        )
    turned = [name for name in ("pitch", "yaw", "roll") if getattr(found, name).deviates]
    if turned:
        angles = ", ".join(f"{name} {_text(getattr(found, name), 1, 'deg', 2)}" for name in turned)
        yield f"the range sensor is turned against its transform: {angles}: calibrate its pose, or correct it by these"


def _text(figure: Figure, factor: float, unit: str, digits: int) -> str:
    return (
        f"{factor * figure.value:+.{digits}f} {unit} (+- {factor * figure.sigma:.{digits}f}, limit "
        f"{factor * figure.limit:g} {unit})"
    )

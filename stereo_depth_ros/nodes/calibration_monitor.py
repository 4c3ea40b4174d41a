# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Monitors the calibration in use by the row errors of live rectified pairs, and corrects it on request."""

from __future__ import annotations

import copy
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from stereo_depth_ros.calibration.auto_correction import AutoCorrection, Correction
from stereo_depth_ros.calibration.misalignment import CorrectionLimits, Misalignment, MisalignmentEstimator
from stereo_depth_ros.calibration.row_error import RowMatches, match_rows
from stereo_depth_ros.config import CalibrationMonitorConfig, CameraInfoConfig, PairingConfig
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.camera_info import sensor_intrinsics
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.images import to_gray
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.types import stamp_ns
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.calibration_input import CalibrationInput, info_contents
from stereo_depth_ros.nodes.interface import CAMERA_INFOS, RECTIFIED_IMAGES, NodeInterface
from stereo_depth_ros.nodes.log import log_warning
from stereo_depth_ros.nodes.message_types import message_class
from stereo_depth_ros.nodes.pair_input import PairInput
from stereo_depth_ros.nodes.range_monitor import RangeMonitor
from stereo_depth_ros.nodes.runner import run

__all__ = ["CalibrationMonitor", "main"]

MIN_MATCHES = 20  # of one pair; with fewer it is ignored
_AXES = ("pitch", "yaw", "roll")
_FIGURES = (
    "row_median_px",
    "row_rms_px",
    *(f"{name}_deg" for name in _AXES),
    "scale",
    "vertical_shift_px",
    *(f"{name}_sigma_deg" for name in _AXES),
    "scale_sigma",
    "matches",
)
_LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class CalibrationMonitor(StereoNode):
    """Its findings are on health/row_error and /diagnostics.

    With range_sensor it also checks disparity against a range sensor: scale of the baseline, offset of the disparities
    and rotation of the sensor are on /diagnostics.

    With auto_correct it publishes right/camera_info_corrected, one for each right/camera_info, for the node that
    rectifies to subscribe instead, and the applied correction, latched, on health/correction.
    """

    interface = NodeInterface(
        "calibration_monitor",
        configs=(PairingConfig, CameraInfoConfig, CalibrationMonitorConfig),
        inputs=CAMERA_INFOS | RECTIFIED_IMAGES | {"disparity": "stereo_msgs/msg/DisparityImage"},
        outputs={
            "health/row_error": "std_msgs/msg/Float64MultiArray",
            "right/camera_info_corrected": "sensor_msgs/msg/CameraInfo",
            "health/correction": "diagnostic_msgs/msg/DiagnosticArray",
        },
        lazy=False,
    )

    def __init__(self) -> None:
        super().__init__()
        self.refuse_equal_topics("left/image_rect", "right/image_rect")
        self._config = self.parameters.get(CalibrationMonitorConfig)
        if self._config.auto_correct and (url := self.parameters.get(CameraInfoConfig).left_camera_info_url):
            raise ConfigError(
                f"auto_correct corrects camera infos of topics, not those of the file {quoted(url)}",
                value=url,
                limit="",
                remedy="publish the camera infos, or leave auto_correct out",
                settings=("auto_correct", "left_camera_info_url"),
            )
        self._calibration = CalibrationInput(self, rectified=True)
        self._row_error = self.add_output("health/row_error")
        self._watch: _Watch | None = None
        self._examined_ns = -math.inf
        self._pairs = PairInput(self, "left/image_rect", "right/image_rect", self._on_pair)
        self.add_input("left/image_rect", self._pairs.add_left)
        self.add_input("right/image_rect", self._pairs.add_right)
        self._row_facts: dict[str, str] = {}
        self._row_warnings: list[str] = []
        self._range: RangeMonitor | None = None
        if self._config.range_sensor:
            self._range = RangeMonitor(self, self._calibration, self._publish_findings)
            self._publish_findings()
        if self._config.auto_correct:
            self._corrected = self.add_output("right/camera_info_corrected")
            correction = "health/correction"
            message_type = message_class(self.interface.outputs[correction])
            self._correction = self.create_publisher(message_type, correction, _LATCHED)
            self.add_input("right/camera_info", self._on_right_info)

    def _on_pair(self, left: Any, right: Any) -> None:
        now_ns, rate = stamp_ns(left.header), self.parameters.get(CalibrationMonitorConfig).health_rate
        due = not rate or not 0 <= now_ns - self._examined_ns < 1e9 / rate
        if due:
            self._examined_ns = now_ns
            self._calibration.with_rig(lambda rig: self._examine(left, right, rig), left, right)

    def _examine(self, left: Any, right: Any, rig: StereoRig) -> None:
        self._pairs.check(left, right, rig)
        pair = self._pairs.decode(left, right)
        with self.diagnostics.timed("match rows"):
            matches = match_rows(to_gray(pair.left), to_gray(pair.right))
        if self._watch is None or self._watch.rig is not rig:
            self._watch = _Watch(rig, self._calibration.right_contents, self._config)
            self._publish_correction(left.header.stamp)
        if len(matches) < MIN_MATCHES:
            self.diagnostics.counters["pairs with too few features"] += 1
            return
        found, corrected = self._watch.add(matches)
        self._row_error.publish(_row_error_message(matches, found))
        self._report(matches, found)
        if corrected:
            self._publish_correction(left.header.stamp)

    def _report(self, matches: RowMatches, found: Misalignment | None) -> None:
        """Notes the row errors for /diagnostics."""
        limit_px = self.parameters.get(CalibrationMonitorConfig).row_error_limit
        self._row_facts = _facts(matches, found)
        warnings = []
        median_px = matches.median_px if found is None else found.row_median_px
        if median_px > limit_px:
            warnings.append(f"median row error {median_px:.2f} px, limit {limit_px:g} px: calibrate again")
        if found is not None and found.detected:
            warnings.append(f"the right camera has moved: {_misalignment_text(found)}")
        if self._watch is not None and self._watch.refusal:
            warnings.append(f"not corrected: {self._watch.refusal}")
        if self._config.auto_correct and not self._corrected.wanted:
            topic = self.resolve_topic_name("right/camera_info_corrected")
            warnings.append(f"{topic} has no subscriber: remap right/camera_info of the rectifying node to this topic")
        self._row_warnings = warnings
        self._publish_findings()

    def _publish_findings(self) -> None:
        """On /diagnostics: row errors, and what the range sensor shows."""
        facts = {} if self._range is None else self._range.facts
        warnings = [] if self._range is None else self._range.warnings
        self.diagnostics.facts = self._row_facts | facts
        self.diagnostics.warning = "; ".join([*self._row_warnings, *warnings])

    def _on_right_info(self, info: Any) -> None:
        """The camera info with the correction, for the sensor; unchanged without one, and for another camera."""
        if self._watch is not None and self._watch.right_contents != info_contents(info):
            self._watch = None
        camera = self._watch.corrected_camera if self._watch is not None else None
        corrected = info
        if camera is not None:
            corrected = copy.copy(info)
            K = sensor_intrinsics(camera.K, info, self.resolve_topic_name("right/camera_info"))
            corrected.k, corrected.r = K.ravel(), camera.R.ravel()
        self._corrected.publish(corrected)

    def _publish_correction(self, stamp: Any) -> None:
        """In the log and on the latched topic."""
        if self._watch is None or (correction := self._watch.correction) is None:
            return
        text = _correction_text(correction)
        if correction.steps:
            log_warning(self.get_logger(), f"right camera corrected by {text}: calibrate again soon")
        values = {
            **{f"{name}_deg": f"{value:.5f}" for name, value in zip(_AXES, correction.rotation_deg, strict=True)},
            "scale": f"{correction.scale:.6f}",
            "steps": str(correction.steps),
        }
        level = DiagnosticStatus.WARN if correction.steps else DiagnosticStatus.OK
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        name = f"{self.get_fully_qualified_name()}: correction"
        message = DiagnosticArray(status=[DiagnosticStatus(level=level, name=name, message=text, values=pairs)])
        message.header.stamp = stamp
        self._correction.publish(message)


class _Watch:
    """The monitoring of one rig, with or without correction; ``right_contents`` of its right camera info."""

    def __init__(
        self, rig: StereoRig, right_contents: tuple[Any, ...] | None, config: CalibrationMonitorConfig
    ) -> None:
        self.rig = rig
        self.right_contents = right_contents
        reference_deg = config.reference_yaw if config.correct_yaw else None
        self._estimator = MisalignmentEstimator(rig, reference_deg)
        self._auto: AutoCorrection | None = None
        if config.auto_correct:
            self._auto = AutoCorrection(rig, CorrectionLimits(config.correction_limit), reference_deg)

    def add(self, matches: RowMatches) -> tuple[Misalignment | None, bool]:
        """The misalignment after this pair, and whether it was corrected."""
        return self._auto.add(matches) if self._auto else (self._estimator.add(matches), False)

    @property
    def refusal(self) -> str:
        """Why a misalignment is not corrected; empty where there is none."""
        return self._auto.refusal if self._auto else ""

    @property
    def corrected_camera(self) -> CameraModel | None:
        """The right camera to rectify with; None while it is the calibrated one."""
        return self._auto.rig.right if self._auto and self._auto.rig is not self.rig else None

    @property
    def correction(self) -> Correction | None:
        """The applied correction; None without auto_correct."""
        return self._auto.correction if self._auto else None


def _row_error_message(matches: RowMatches, found: Misalignment | None) -> Any:
    """The figures in one array; their names, in this order, are the label of its dimension; NaN where not known."""
    unknown = [math.nan] * (len(_FIGURES) - 3)
    values = [matches.median_px, matches.rms_px, *unknown, float(len(matches))]
    if found is not None:
        estimated = [*found.rotation_deg, found.scale, found.shift_px, *found.rotation_sigma_deg, found.scale_sigma]
        values = [matches.median_px, matches.rms_px, *estimated, float(len(matches))]
    message = Float64MultiArray(data=[float(value) for value in values])
    label = ",".join(_FIGURES)
    message.layout.dim = [MultiArrayDimension(label=label, size=len(values), stride=len(values))]
    return message


def _facts(matches: RowMatches, found: Misalignment | None) -> dict[str, str]:
    facts = {"row error median px": f"{matches.median_px:.3f}", "row error rms px": f"{matches.rms_px:.3f}"}
    if found is None:
        return facts
    facts |= {"row error median px": f"{found.row_median_px:.3f}", "row error rms px": f"{found.row_rms_px:.3f}"}
    for name, value, sigma in zip(_AXES, found.rotation_deg, found.rotation_sigma_deg, strict=True):
        facts[f"{name} deg"] = f"{value:+.4f} +- {sigma:.4f}"
    facts["scale"] = f"{found.scale:+.5f} +- {found.scale_sigma:.5f}"
    facts["vertical shift px"] = f"{found.shift_px:+.3f}"
    return facts | {"matches": str(found.matches), "pairs": str(found.frames)}


def _misalignment_text(found: Misalignment) -> str:
    degrees = dict(zip(_AXES, found.rotation_deg, strict=True))
    return ", ".join(
        f"{name} {100 * found.scale:+.3f} %" if name == "scale" else f"{name} {degrees[name]:+.3f} deg"
        for name in found.significant
    )


def _correction_text(correction: Correction) -> str:
    turn = ", ".join(f"{name} {value:+.3f}" for name, value in zip(_AXES, correction.rotation_deg, strict=True))
    return f"{turn} deg, focal length {100 * correction.scale:+.3f} %"


def main() -> int:
    """Run the node."""
    return run(CalibrationMonitor)


if __name__ == "__main__":
    raise SystemExit(main())

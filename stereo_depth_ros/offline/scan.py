# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans without a ROS graph: captures of projected patterns to depth, with the message bytes of the live node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stereo_depth_ros.active.scanner import Scanner
from stereo_depth_ros.active.shown_patterns import ShownPatterns
from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.camera_info import camera_info_message
from stereo_depth_ros.offline.captures import CaptureSource, find_sequences
from stereo_depth_ros.offline.provenance import provenance
from stereo_depth_ros.outputs import OUTPUTS, ResultMessages
from stereo_depth_ros.pipeline import StereoResult

__all__ = ["ScanSummary", "scan_captures"]


@dataclass(frozen=True)
class ScanSummary:
    """One scan.

    Attributes:
        stamp_ns: of its capture under white light.
        valid_fraction: share of the pixels that have a depth, 0..1.
        median_depth_m: of these pixels, meters.
        reasons: pixels without a depth, by the name of the reason; a pixel may have several.
        timings_ms: milliseconds by name of the step.
    """

    stamp_ns: int
    valid_fraction: float
    median_depth_m: float
    reasons: dict[str, int]
    timings_ms: dict[str, float]

    @classmethod
    def of(cls, result: StereoResult) -> ScanSummary:
        """That of a result."""
        match = result.disparity
        median_m = float(np.nanmedian(result.depth_m))
        return cls(result.stamp_ns, match.valid_fraction, median_m, match.reason_counts(), dict(result.timings_ms))

    def to_json(self) -> dict[str, Any]:
        """The scan as plain data."""
        return {
            "stamp": self.stamp_ns / 1e9,
            "valid_fraction": self.valid_fraction,
            "median_depth_m": self.median_depth_m,
            "reasons": self.reasons,
            "timings_ms": self.timings_ms,
        }


def scan_captures(
    source: CaptureSource,
    patterns: ShownPatterns,
    output: Path,
    config: PipelineConfig,
    *,
    settle: int = 1,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
    each: Callable[[StereoResult], None] = lambda result: None,
) -> list[ScanSummary]:
    """Compute every scan of a bag or folder and write its outputs into an MCAP bag.

    Args:
        source: the captures.
        patterns: what they show.
        output: the bag to write.
        config: parameters of the outputs.
        settle: captures that are skipped after a change of the pattern.
        overwrite: replace an existing output.
        progress: called with the captures read, twice.
        each: called with every result.

    Raises:
        BagError, TopicError, CalibrationError, ImageError, MessageError: captures that are no scan; nothing is written.
        OutputError: an existing output without ``overwrite``, or it cannot be written.
    """
    types, summaries = RosbagsTypes(), []
    messages = ResultMessages(types)
    scanner: Scanner | None = None
    with BagWriter(output, compression="lz4", overwrite=overwrite) as writer:
        for captures, rig in find_sequences(source.read(), patterns, source.announcements(), settle, progress):
            if scanner is None or scanner.rig is not rig:
                scanner = Scanner(config, rig, patterns)
            result = scanner.scan(captures)
            _write_infos(writer, types, rig, result.stamp_ns)
            for topic, _, build in OUTPUTS:
                writer.write(f"/{topic}", build(messages, result), result.stamp_ns)
            summaries.append(ScanSummary.of(result))
            each(result)
        writer.write_metadata("stereo_depth_ros", provenance(config, rig, bag=source.selection.path))
    return summaries


def _write_infos(writer: BagWriter, types: RosbagsTypes, rig: StereoRig, stamp_ns: int) -> None:
    for side, camera in (("left", rig.left), ("right", rig.right)):
        writer.write(f"/{side}/camera_info", camera_info_message(types, camera, stamp_ns), stamp_ns)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the stamps of both cameras: pairs, offset, rate, drops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.config import PairingConfig
from stereo_depth_ros.core.pairing import StereoPairing
from stereo_depth_ros.core.unpaired import STAMP_REMEDY, stamp_offset_ns, taken_together
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.diagnosis.survey import NEAR

__all__ = ["check_streams"]

MIN_PAIRED = 0.9  # share of the images of the camera that has fewer
MAX_OFFSET_MS = 1.0  # a rotation of 1 rad/s moves the image of a lens of 500 px by half a pixel in this time
MAX_DROPPED = 0.01
MAX_RATE_RATIO = 1.05


def check_streams(left_ns: Sequence[int], right_ns: Sequence[int]) -> list[Finding]:
    """Order, pairs, offset, rates and drops by the header stamps of both cameras.

    Args:
        left_ns, right_ns: of all images, in order of arrival, integer nanoseconds.
    """
    if not len(left_ns) or not len(right_ns):
        return []
    findings = [_check_order(side, stamps) for side, stamps in (("left", left_ns), ("right", right_ns))]
    if not any(left_ns) or not any(right_ns):
        return [*findings, Finding("pairs", Level.SKIPPED, "stamps are not set", "stamps of both cameras")]
    exact = _pairs(left_ns, right_ns, PairingConfig())
    near = _pairs(left_ns, right_ns, NEAR)
    offset_ns = stamp_offset_ns(left_ns, right_ns)
    findings.append(_check_pairs(len(exact), near, min(len(left_ns), len(right_ns)), offset_ns))
    if near:
        findings.append(_check_offset(near))
    rates = [_rate_hz(stamps) for stamps in (left_ns, right_ns)]
    if rates[0] and rates[1]:
        findings.append(_check_rates(rates[0], rates[1]))
        findings += [_check_drops(side, stamps) for side, stamps in (("left", left_ns), ("right", right_ns))]
    return findings


def _pairs(left_ns: Sequence[int], right_ns: Sequence[int], config: PairingConfig) -> list[tuple[int, int]]:
    """Left and right stamp of each pair, as the nodes pair them when no message is late."""
    pairing: StereoPairing[int] = StereoPairing(config)
    pairs: list[tuple[int, int]] = []
    stamps = [(stamp, True) for stamp in left_ns] + [(stamp, False) for stamp in right_ns]
    for stamp_ns, is_left in sorted(stamps):
        pairs += (pairing.add_left if is_left else pairing.add_right)(stamp_ns, stamp_ns)
    return pairs + pairing.flush()


def _check_order(side: str, stamps: Sequence[int]) -> Finding:
    steps = np.diff(np.array(stamps, np.int64))
    check, limit = f"{side} stamps", "set, ascending"
    if not any(stamps):
        return Finding(check, Level.ERROR, "all 0, which means not set", limit, STAMP_REMEDY)
    equal, back = int((steps == 0).sum()), int((steps < 0).sum())
    if equal or back:
        remedy = "check the clock of the driver; a bag that is looped or two publishers on a topic do this too"
        return Finding(check, Level.WARNING, f"{equal} equal, {back} backwards of {len(stamps)}", limit, remedy)
    return Finding(check, Level.OK, f"{len(stamps)} images", limit)


def _check_pairs(exact: int, near: list[tuple[int, int]], images: int, offset_ns: int | None) -> Finding:
    limit = f"{100 * MIN_PAIRED:.0f} % of equal stamps"
    value = (
        f"{exact} of {images} of equal stamps, {len(near)} within {1e3 * NEAR.approximate_sync_tolerance_seconds:g} ms"
    )
    figures = {"exact": float(exact), "near": float(len(near)), "images": float(images)}
    if exact >= MIN_PAIRED * images:
        return Finding("pairs", Level.OK, value, limit, "", figures)
    if len(near) > exact:
        largest_s = max(abs(right - left) for left, right in near) * 1e-9
        tolerance_s = round(max(1e-3, float(np.ceil(1.2e3 * largest_s)) * 1e-3), 3)
        settings = {"approximate_sync": True, "approximate_sync_tolerance_seconds": tolerance_s}
        remedy = "pair stamps that differ, or better let one signal trigger both cameras"
        return Finding("pairs", Level.WARNING if exact else Level.ERROR, value, limit, remedy, figures, settings)
    if exact:
        remedy = "images of one camera are missing: check the drops, the load and the bandwidth"
        return Finding("pairs", Level.WARNING, value, limit, remedy, figures)
    remedy = "synchronize the cameras and their clocks: no two images were taken together"
    if offset_ns:
        remedy = f"synchronize the cameras and their clocks; {taken_together(offset_ns)}"
    return Finding("pairs", Level.ERROR, value, limit, remedy, figures)


def _check_offset(near: list[tuple[int, int]]) -> Finding:
    offsets_ms = np.array([right - left for left, right in near]) * 1e-6
    median_ms, spread_ms = float(np.median(offsets_ms)), float(np.ptp(offsets_ms))
    value, limit = f"right after left by {median_ms:.3f} ms, spread {spread_ms:.3f} ms", f"{MAX_OFFSET_MS:g} ms"
    figures = {"median_ms": median_ms, "spread_ms": spread_ms}
    if np.abs(offsets_ms).max() <= MAX_OFFSET_MS:
        return Finding("stamp offset", Level.OK, value, limit, "", figures)
    remedy = "a moving object is seen at two places: let one signal trigger both cameras"
    return Finding("stamp offset", Level.WARNING, value, limit, remedy, figures)


def _intervals_ns(stamps: Sequence[int]) -> npt.NDArray[np.int64]:
    sorted_ns: npt.NDArray[np.int64] = np.unique(np.array(stamps, np.int64))
    return sorted_ns[1:] - sorted_ns[:-1]


def _rate_hz(stamps: Sequence[int]) -> float:
    steps = _intervals_ns(stamps)
    return float(1e9 / np.median(steps)) if steps.size else 0.0


def _check_rates(left_hz: float, right_hz: float) -> Finding:
    value, limit = f"{left_hz:.2f}, {right_hz:.2f} Hz", f"equal within {100 * (MAX_RATE_RATIO - 1):.0f} %"
    figures = {"left_hz": left_hz, "right_hz": right_hz}
    if max(left_hz, right_hz) <= MAX_RATE_RATIO * min(left_hz, right_hz):
        return Finding("rates", Level.OK, value, limit, "", figures)
    remedy = "give both cameras the same rate and exposure settings"
    return Finding("rates", Level.WARNING, value, limit, remedy, figures)


def _check_drops(side: str, stamps: Sequence[int]) -> Finding:
    steps = _intervals_ns(stamps)
    missing = int((np.rint(steps / np.median(steps)) - 1).clip(0).sum())
    total = len(steps) + 1 + missing
    value, limit = f"{missing} of {total} images missing", f"{100 * MAX_DROPPED:.0f} %"
    figures = {"missing": float(missing), "share": missing / total}
    if missing <= MAX_DROPPED * total:
        return Finding(f"{side} drops", Level.OK, value, limit, "", figures)
    remedy = "check the load, the bandwidth of the camera's bus, and the disk of the recorder"
    return Finding(f"{side} drops", Level.WARNING, value, limit, remedy, figures)

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gives findings that have one root cause the remedy of that cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stereo_depth_ros.core.rig import MAX_OFFSET
from stereo_depth_ros.diagnosis.finding import Finding, Level

__all__ = ["settled"]

_ORDER, _REFERENCE, _SIGN = "order of the cameras", "left P[:, 3]", "right P[0,3]"
_FRAMES = ("left frame_id", "right frame_id")
# checks that may show the root cause of another check's error
_ROOT_CAUSES = {
    "rows": ("left center", "right center", "left field of view", "right field of view", "rectified image"),
    "sizes": ("left image size", "right image size"),
}


def settled(findings: Sequence[Finding]) -> list[Finding]:
    """The same findings; errors that follow from a root cause have its remedy."""
    remedies = _remedies_of_order(findings)
    for check, causes in _ROOT_CAUSES.items():
        cause = [finding for finding in findings if finding.check in causes and finding.level > Level.SKIPPED]
        if cause:
            remedies[check] = max(cause, key=lambda finding: finding.level).remedy
    return [
        replace(finding, remedy=remedies.get(finding.check, finding.remedy))
        if finding.level is Level.ERROR
        else finding
        for finding in findings
    ]


def _remedies_of_order(findings: Sequence[Finding]) -> dict[str, str]:
    """Camera infos and frame names only show that something is swapped; the images show what."""
    order = next((finding for finding in findings if finding.check == _ORDER), None)
    if order is None or order.level is Level.SKIPPED:
        return {}
    swapped = _infos_are_swapped(findings)
    if order.level is Level.ERROR:
        return dict.fromkeys((*((_REFERENCE,) if swapped else ()), _SIGN, *_FRAMES), order.remedy)
    remedies = dict.fromkeys(_FRAMES, "the images are in order: exchange the frame_ids")
    if swapped:
        return remedies | dict.fromkeys(
            (_REFERENCE, _SIGN), "the images are in order: exchange the camera infos, or their P"
        )
    if any(finding.check == _SIGN and finding.figures.get("right") for finding in findings):
        remedies[_SIGN] = "the images are in order: change the sign of P[0,3]"
    return remedies


def _infos_are_swapped(findings: Sequence[Finding]) -> bool:
    """The left camera is not the reference, and stands to the right of the right one."""
    reference = next((finding for finding in findings if finding.check == _REFERENCE), None)
    left, right = ((reference.figures.get(side) if reference else None) or 0.0 for side in ("left", "right"))
    return right - left > MAX_OFFSET * max(abs(left), abs(right))

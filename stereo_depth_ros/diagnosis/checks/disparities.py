# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the disparities of matched features: order of the cameras, search range, depths."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.diagnosis.checks.rows import MIN_MATCHES, ImageArrayPairs, RowMatching, match_image_pairs, too_few
from stereo_depth_ros.diagnosis.finding import Finding, Level
from stereo_depth_ros.stages.camera_swap import CameraSwapDetector

__all__ = ["check_camera_order", "check_depths"]

BEHIND_PX = 1.0  # a disparity this far below infinity is not noise
MOSTLY = 0.5
SEARCH_MARGIN = 0.15  # share of the disparities seen that is added for nearer points
FREE_PX = 16  # up to this many more disparities, down to infinity, are searched anyway


def check_camera_order(
    given: ImageArrayPairs,
    matching: RowMatching,
    exchanged: Callable[[], ImageArrayPairs],
    doffs_px: float,
    columns_fit: bool,
) -> Finding:
    """Whether left and right are in order: the features lie in front of the cameras.

    Args:
        given: rectified images.
        matching: of their features.
        exchanged: rectifies the images with left and right exchanged.
        doffs_px: disparity of infinity, px.
        columns_fit: the camera infos are in order.
    """
    check, limit = "order of the cameras", f"up to {100 * MOSTLY:.0f} % behind infinity"
    behind = _share_behind(matching, doffs_px)
    value = f"{100 * behind:.1f} % of the features behind infinity"
    figures: dict[str, float | None] = {"share_behind": behind}
    if matching.fits and behind > MOSTLY:
        remedy = "exchange the image topics of left and right" + ("" if columns_fit else " and those of the infos")
        return Finding(check, Level.ERROR, f"cameras swapped: {value}", limit, remedy, figures)
    if not matching.fits:
        other = match_image_pairs(exchanged())
        if other.fits and len(other) > len(matching) / 2:
            in_front = _share_behind(other, doffs_px) <= MOSTLY
            what = "image topics" if in_front else "camera infos"
            value = f"cameras swapped: rows fit to {other.median_px:.2f} px with the images exchanged"
            return Finding(check, Level.ERROR, value, limit, f"exchange the {what} of left and right", figures)
        try:
            _check_order(given, exchanged, doffs_px)
        except ImageError as error:
            return Finding.refused(check, error, limit)
    if len(matching) < MIN_MATCHES:
        return replace(too_few(check, matching), remedy="")
    return Finding(check, Level.OK, value, limit, "", figures)


def _share_behind(matching: RowMatching, doffs_px: float) -> float:
    """Share of the features behind infinity, 0..1."""
    return float((matching.disparity_px < doffs_px - BEHIND_PX).mean()) if len(matching) else 0.0


def _check_order(given: ImageArrayPairs, exchanged: Callable[[], ImageArrayPairs], doffs_px: float) -> None:
    """The check of the nodes, on the first pair."""
    CameraSwapDetector(doffs_px).check(*given[0], lambda: exchanged()[0])


def check_depths(matching: RowMatching, rig: StereoRig, real_baseline: bool) -> Iterable[Finding]:
    """Disparities and depths of the features, and the search range that covers them; nothing where rows do not fit."""
    disparity = matching.disparity_px
    seen = disparity[disparity > rig.doffs_px]
    if not matching.fits or seen.size < MIN_MATCHES:
        return
    low, high = (float(value) for value in np.percentile(seen, (0.5, 99.5)))
    first, count = _search(low, high, rig.doffs_px)
    value = f"{low:.1f}..{high:.1f} px, search from {first} to {first + count - 1}"
    figures: dict[str, float | None] = {
        "low_px": low,
        "high_px": high,
    }
    settings = {"min_disparity": first, "disparity_range": count}
    limit = f"half the width, {rig.width // 2} px"
    if first + count > rig.width // 2:
        remedy = "the scene is too near for this rig: step back, or use a smaller baseline"
        yield Finding("disparities", Level.WARNING, value, limit, remedy, figures, settings)
    else:
        yield Finding("disparities", Level.OK, value, limit, "", figures, settings)
    if real_baseline:
        depth_m = rig.f_px * rig.baseline_m / (seen - rig.doffs_px)
        near_m, far_m = (float(value) for value in np.percentile(depth_m, (2, 98)))
        figures = {"near_m": near_m, "far_m": far_m}
        yield Finding("depths of the features", Level.OK, f"{near_m:.2f}..{far_m:.2f} m", "plausible", "", figures)


def _search(low: float, high: float, doffs_px: float) -> tuple[int, int]:
    """min_disparity and disparity_range that cover these disparities with a margin, and infinity where it is near."""
    margin = SEARCH_MARGIN * (high - doffs_px)
    infinity = math.floor(doffs_px)
    first = max(infinity, math.floor(low - margin))
    if first - infinity <= FREE_PX:
        first = min(infinity, 0) if abs(infinity) <= FREE_PX else infinity
    count = 16 * math.ceil((high + margin + 1 - first) / 16)
    return first, max(32, count)

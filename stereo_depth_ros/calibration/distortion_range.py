# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lenses whose distortion folds back within the image, where no corners of a board were seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.bundle_adjustment import BundleAdjustment, Estimate, adjust_bundle
from stereo_depth_ros.calibration.projection import parameter_names, turning_radius_px
from stereo_depth_ros.core.errors import CalibrationError

__all__ = ["check_edges", "left_out", "without_folding"]

_NO_LOSS = 1.01  # times the rms: what a coefficient may cost that the views do not determine
_RADIAL = ("k6", "k5", "k4", "k3", "k2")  # left out in this order


def without_folding(
    pairs: Sequence[tuple[Corners, Corners]], whole: BundleAdjustment, size: tuple[int, int]
) -> BundleAdjustment:
    """With the highest radial coefficients 0 if a lens folds back within the image and the fit does not need them.

    Where no corners were seen the coefficients may be anything; of a lens that folds there is no rectified image.

    Args:
        pairs: left and right corners of each view.
        whole: solved with all coefficients; returned where it does not fold, and where leaving out does not help.
        size: width, height of the images, px.
    """
    found, names = whole, parameter_names(whole.estimate.model)
    for name in _RADIAL:
        if name not in names:
            continue
        if not any(turn_px < corner_px for turn_px, corner_px in _turns(found.estimate, size)):
            return found
        estimate, number = found.estimate, names.index(name)
        intrinsics = tuple(np.where(np.arange(each.size) == number, 0.0, each) for each in estimate.intrinsics)
        found = adjust_bundle(pairs, replace(estimate, intrinsics=intrinsics, fixed=(*estimate.fixed, number)))
        if found.rms_px() > _NO_LOSS * whole.rms_px():
            return whole
    return whole if any(turn_px < corner_px for turn_px, corner_px in _turns(found.estimate, size)) else found


def left_out(estimate: Estimate) -> list[str]:
    """Names of the coefficients that :func:`without_folding` left 0."""
    return [parameter_names(estimate.model)[number] for number in sorted(estimate.fixed)]


def check_edges(estimate: Estimate, size: tuple[int, int]) -> None:
    """OpenCV fits the rectified fisheye image to the middles of the raw one's edges, which need to have rays.

    Raises:
        CalibrationError: a fisheye that folds back nearer than these.
    """
    if estimate.model != "equidistant":
        return
    for side, intrinsics, (turn_px, _) in zip(
        ("left", "right"), estimate.intrinsics, _turns(estimate, size), strict=True
    ):
        cx, cy = intrinsics[2:4]
        edge_px = max(cx, size[0] - 1 - cx, cy, size[1] - 1 - cy)
        if turn_px < edge_px:
            raise CalibrationError(
                f"{side}: beyond {turn_px:.0f} px from the center the distortion folds back, the edges of the image "
                f"are up to {edge_px:.0f} px away: it cannot be rectified, show the board near the edges, too"
            )


def _turns(estimate: Estimate, size: tuple[int, int]) -> list[tuple[float, float]]:
    return [turning_radius_px(estimate.model, each, size) for each in estimate.intrinsics]

# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distortion range: the radius up to which a fitted radial distortion increases, beyond the detected corners too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.bundle_adjustment import BundleParameters, BundleSolution, adjust_bundle
from stereo_depth_ros.calibration.projection import distortion_range_px, parameter_names
from stereo_depth_ros.core.errors import CalibrationError

__all__ = ["check_distortion_range", "ensure_monotonic_distortion", "zeroed_coefficients"]

_MAX_RMS_RATIO = 1.01  # of the rms without and with a coefficient that the views do not determine
_RADIAL = ("k6", "k5", "k4", "k3", "k2")  # order in which coefficients are fixed at 0


def ensure_monotonic_distortion(
    pairs: Sequence[tuple[Corners, Corners]], whole: BundleSolution, size: tuple[int, int]
) -> BundleSolution:
    """Fix the highest radial coefficients at 0 where the distortion decreases within the image without need.

    Coefficients are not constrained where no corners were detected; a distortion that is not monotonic cannot be
    rectified.

    Args:
        pairs: left and right corners of each view.
        whole: solution with all coefficients; returned where it is monotonic, and where fewer coefficients fit worse.
        size: width, height of the images, px.
    """
    found, names = whole, parameter_names(whole.parameters.model)
    for name in _RADIAL:
        if name not in names:
            continue
        if _is_monotonic(found.parameters, size):
            return found
        parameters, index = found.parameters, names.index(name)
        intrinsics = tuple(np.where(np.arange(each.size) == index, 0.0, each) for each in parameters.intrinsics)
        found = adjust_bundle(pairs, replace(parameters, intrinsics=intrinsics, fixed=(*parameters.fixed, index)))
        if found.rms_px() > _MAX_RMS_RATIO * whole.rms_px():
            return whole
    return found if _is_monotonic(found.parameters, size) else whole


def zeroed_coefficients(parameters: BundleParameters) -> list[str]:
    """Names of the coefficients that :func:`ensure_monotonic_distortion` fixed at 0."""
    return [parameter_names(parameters.model)[index] for index in sorted(parameters.fixed)]


def check_distortion_range(parameters: BundleParameters, size: tuple[int, int]) -> None:
    """Check that the centers of the image edges are within the distortion range of a fisheye, as OpenCV requires.

    Raises:
        CalibrationError: the range of a fisheye ends before them.
    """
    if parameters.model != "equidistant":
        return
    for side, intrinsics in zip(("left", "right"), parameters.intrinsics, strict=True):
        range_px, _ = distortion_range_px(parameters.model, intrinsics, size)
        cx, cy = intrinsics[2:4]
        edge_px = max(cx, size[0] - 1 - cx, cy, size[1] - 1 - cy)
        if range_px < edge_px:
            raise CalibrationError(
                f"the distortion decreases beyond {range_px:.0f} px from the principal point, the edges of the image "
                f"are up to {edge_px:.0f} px away: it cannot be rectified",
                subject=f"{side} camera",
                value=range_px,
                limit=edge_px,
                remedy="show the board near the edges of the image too",
            )


def _is_monotonic(parameters: BundleParameters, size: tuple[int, int]) -> bool:
    ranges = [distortion_range_px(parameters.model, each, size) for each in parameters.intrinsics]
    return all(range_px >= corner_px for range_px, corner_px in ranges)

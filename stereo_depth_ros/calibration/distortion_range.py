# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distortion range: the radius up to which a fitted radial distortion increases, beyond the detected corners too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from stereo_depth_ros.calibration.boards import Corners
from stereo_depth_ros.calibration.bundle_adjustment import BundleParameters, BundleSolution, adjust_bundle
from stereo_depth_ros.calibration.lens_circle import LensCircle
from stereo_depth_ros.calibration.projection import distortion_range_px, parameter_names
from stereo_depth_ros.core.errors import CalibrationError
from stereo_depth_ros.core.types import F64

__all__ = [
    "Circles",
    "check_distortion_range",
    "ensure_monotonic_distortion",
    "needed_range_px",
    "zeroed_coefficients",
]

Circles: TypeAlias = tuple[LensCircle | None, LensCircle | None]  # of the left and the right lens

_MAX_RMS_RATIO = 1.01  # of the rms without and with a coefficient that the views do not determine
_LEAST_OF_CIRCLE = 0.8  # corners of a board hardly come closer to the edge of the image circle
_RADIAL = ("k6", "k5", "k4", "k3", "k2")  # order in which coefficients are fixed at 0


def ensure_monotonic_distortion(
    pairs: Sequence[tuple[Corners, ...]],
    whole: BundleSolution,
    size: tuple[int, int],
    circles: Sequence[LensCircle | None] = (None, None),
) -> BundleSolution:
    """Fix the highest radial coefficients at 0 where the distortion decreases within the image without need.

    Coefficients are not constrained where no corners were detected; a distortion that is not monotonic cannot be
    rectified.

    Args:
        pairs: left and right corners of each view, or those of one camera.
        whole: solution with all coefficients; returned where it is monotonic, and where fewer coefficients fit worse.
        size: width, height of the images, px.
        circles: image circles of both lenses, outside which there is no image, or of the one of one camera.
    """
    found, names = whole, parameter_names(whole.parameters.model)
    for name in _RADIAL:
        if name not in names:
            continue
        if _is_monotonic(found.parameters, size, circles):
            return found
        parameters, index = found.parameters, names.index(name)
        intrinsics = tuple(np.where(np.arange(each.size) == index, 0.0, each) for each in parameters.intrinsics)
        found = adjust_bundle(pairs, replace(parameters, intrinsics=intrinsics, fixed=(*parameters.fixed, index)))
        if found.rms_px() > _MAX_RMS_RATIO * whole.rms_px():
            return whole
    return found if _is_monotonic(found.parameters, size, circles) else whole


def zeroed_coefficients(parameters: BundleParameters) -> list[str]:
    """Names of the coefficients that :func:`ensure_monotonic_distortion` fixed at 0."""
    return [parameter_names(parameters.model)[index] for index in sorted(parameters.fixed)]


def needed_range_px(intrinsics: F64, corner_px: float, circle: LensCircle | None) -> float:
    """Largest radius at which there is image: of the farthest corner, or within the image circle, px."""
    return corner_px if circle is None else min(corner_px, circle.reach_px(*intrinsics[2:4]))


def check_distortion_range(
    parameters: BundleParameters, size: tuple[int, int], circles: Circles = (None, None)
) -> None:
    """Check that the centers of the image edges are within the distortion range of a fisheye, as OpenCV requires.

    With an image circle, that most of the circle is.

    Raises:
        CalibrationError: the range of a fisheye ends before them.
    """
    if parameters.model != "equidistant":
        return
    for side, intrinsics, circle in zip(("left", "right"), parameters.intrinsics, circles, strict=True):
        range_px, corner_px = distortion_range_px(parameters.model, intrinsics, size)
        cx, cy = intrinsics[2:4]
        if circle is not None:
            reach_px = needed_range_px(intrinsics, corner_px, circle)
            if range_px < _LEAST_OF_CIRCLE * reach_px:
                raise CalibrationError(
                    f"the distortion decreases beyond {range_px:.0f} px from the principal point, the image circle "
                    f"({circle}) reaches {reach_px:.0f} px: it cannot be rectified",
                    subject=f"{side} camera",
                    value=range_px,
                    limit=reach_px,
                    remedy="show the board near the edge of the circle too",
                )
            continue
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


def _is_monotonic(parameters: BundleParameters, size: tuple[int, int], circles: Sequence[LensCircle | None]) -> bool:
    for intrinsics, circle in zip(parameters.intrinsics, circles, strict=True):
        range_px, corner_px = distortion_range_px(parameters.model, intrinsics, size)
        if range_px < needed_range_px(intrinsics, corner_px, circle):
            return False
    return True

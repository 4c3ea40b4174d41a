# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Depth range of a rig: nearest and farthest depth, depth errors by depth, and the disparity search for a range."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.triangulation import Triangulation
from stereo_depth_ros.stages.depth import depth_sigma

__all__ = [
    "DepthError",
    "DepthRange",
    "Precision",
    "default_nearest_m",
    "depth_errors",
    "depth_range",
    "recommended_search",
    "rounded_depths_m",
]

_DEFAULT_SHARE = 1 / 8  # default disparity of the nearest point as a fraction of the image width
_MIN_DEPTHS, _MAX_DEPTHS = 5, 200  # least and largest number of depths of a table
_ROUNDING_PX = 1e-6  # disparities this near to a whole number are rounded to it


@dataclass(frozen=True)
class Precision:
    """Precision of disparities, and the precision required of depths.

    Attributes:
        step_px: smallest difference between two disparities of the matcher.
        sigma_px: standard deviation of a disparity.
        max_error: largest acceptable standard deviation of a depth, as a share of the depth, 0..1.

    Raises:
        ConfigError: a value that is not above 0, or ``max_error`` above 1.
    """

    step_px: float
    sigma_px: float
    max_error: float

    def __post_init__(self) -> None:
        for name in ("step_px", "sigma_px", "max_error"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ConfigError(
                    f"{name} = {value:g} is not above 0",
                    value=value,
                    limit=0.0,
                    remedy="use a finite value above 0",
                    settings=(name,),
                )
        if self.max_error > 1:
            raise ConfigError(
                f"the depth error {100 * self.max_error:g} % is above 100 %",
                value=self.max_error,
                limit=1.0,
                remedy="use a smaller error",
                settings=("max_error",),
            )


@dataclass(frozen=True)
class DepthRange:
    """Depth range of a rig, meters along Z of the left rectified camera.

    Attributes:
        baseline_m: distance between the two cameras.
        nearest_m: depth of the largest disparity searched.
        farthest_m: depth beyond which the depth error exceeds the acceptable one.
        search_end_m: depth of the smallest disparity searched; infinite where the search includes infinity.
    """

    baseline_m: float
    nearest_m: float
    farthest_m: float
    search_end_m: float


@dataclass(frozen=True)
class DepthError:
    """Depth error and overlap of a rig at one depth.

    Attributes:
        depth_m: Z in the left rectified camera.
        disparity_px: x_left - x_right.
        step_m: from this depth to that of the next smaller disparity; infinite where that is at infinity.
        sigma_m: standard deviation of the depth.
        overlap: share of the left rectified image that is visible in the right one too, 0..1.
        common_width_m: width of the overlap.
    """

    depth_m: float
    disparity_px: float
    step_m: float
    sigma_m: float
    overlap: float
    common_width_m: float


def depth_range(
    rig: StereoRig, search: MatchingConfig, precision: Precision, baseline_factor: float = 1.0
) -> DepthRange:
    """Depth range of a rig, or of the same rig with its baseline multiplied by ``baseline_factor``.

    Nearest: Z = f B / (d_max - doffs). Farthest: sigma_Z = Z^2 / (f B) sigma_d reaches the acceptable share of Z,
    Z = max_error f B / sigma_d.

    Raises:
        ConfigError: no disparity searched is in front of the cameras.
    """
    baseline_m = baseline_factor * rig.baseline_m
    f_baseline = rig.f_px * baseline_m
    nearest_px = search.max_disparity - rig.doffs_px
    if nearest_px <= 0:
        raise ConfigError(
            f"the search ends at {search.max_disparity} px, below the disparity of infinity, {rig.doffs_px:.2f} px",
            value=search.max_disparity,
            limit=rig.doffs_px,
            remedy="search larger disparities",
            settings=("min_disparity", "disparity_range"),
        )
    last_px = search.min_disparity - rig.doffs_px
    return DepthRange(
        baseline_m=baseline_m,
        nearest_m=f_baseline / nearest_px,
        farthest_m=precision.max_error * f_baseline / precision.sigma_px,
        search_end_m=f_baseline / last_px if last_px > 0 else math.inf,
    )


def depth_errors(
    rig: StereoRig, depths_m: list[float], precision: Precision, baseline_factor: float = 1.0
) -> list[DepthError]:
    """Errors of a rig at these depths, above 0, or of the same rig with its baseline multiplied."""
    t = Triangulation.from_rig(rig)
    t = replace(t, baseline_m=baseline_factor * t.baseline_m)
    sigmas_m = depth_sigma(np.array([depths_m], np.float32), t, precision.sigma_px)[0].tolist()
    errors = []
    for depth_m, sigma_m in zip(depths_m, sigmas_m, strict=True):
        parallax_px = t.f_px * t.baseline_m / depth_m  # the disparity minus that of infinity
        residual_px = parallax_px - precision.step_px
        disparity_px = parallax_px + t.doffs_px
        overlap = max(0.0, 1 - abs(disparity_px) / rig.width)
        errors.append(
            DepthError(
                depth_m=depth_m,
                disparity_px=disparity_px,
                step_m=depth_m * precision.step_px / residual_px if residual_px > 0 else math.inf,
                sigma_m=sigma_m,
                overlap=overlap,
                common_width_m=overlap * rig.width * depth_m / t.f_px,
            )
        )
    return errors


def recommended_search(rig: StereoRig, nearest_m: float) -> MatchingConfig:
    """The smallest disparity search from a distance to infinity; all other parameters have their defaults.

    It starts at the disparity of infinity and ends one whole disparity above that of the nearest point, for sub-pixel
    interpolation. disparity_range is a multiple of 16, at least 32.

    Raises:
        ConfigError: the images have no overlap at this distance, or a parameter would be out of range.
    """
    if not 0 < nearest_m < math.inf:
        raise ConfigError(
            f"nearest distance {nearest_m:g} m is not above 0",
            value=nearest_m,
            limit=0.0,
            remedy="give meters",
            settings=("nearest",),
        )
    nearest_px = rig.f_px * rig.baseline_m / nearest_m + rig.doffs_px
    if nearest_px >= rig.width:
        limit_m = rig.f_px * rig.baseline_m / (rig.width - rig.doffs_px)
        raise ConfigError(
            f"at {nearest_m:g} m the disparity is {nearest_px:.0f} px and the images are {rig.width} px wide: they "
            f"overlap only beyond {limit_m:.3g} m",
            value=nearest_m,
            limit=limit_m,
            remedy="increase the nearest distance or reduce the baseline",
            settings=("nearest",),
        )
    first = math.floor(rig.doffs_px + _ROUNDING_PX)
    last = math.floor(nearest_px + _ROUNDING_PX) + 1
    count = max(32, 16 * math.ceil((last + 1 - first) / 16))
    return MatchingConfig(min_disparity=first, num_disparities=count)


def default_nearest_m(rig: StereoRig) -> float:
    """The distance, meters, at which the disparity is an eighth of the image width above that of infinity."""
    return rig.f_px * rig.baseline_m / (_DEFAULT_SHARE * rig.width)


def rounded_depths_m(first_m: float, last_m: float) -> list[float]:
    """Multiples of a step from the first to the last depth; the step is 1 m where that gives 5 to 200 depths.

    Otherwise it is another one of 1, 2 or 5 times a power of ten.
    """
    length = last_m - first_m
    steps = [factor * 10.0**power for power in range(-3, 7) for factor in (1, 2, 5)]
    fine = [step for step in steps if step <= 1 and length / step >= _MIN_DEPTHS]
    step = fine[-1] if fine else steps[0]
    if length / step > _MAX_DEPTHS:
        step = next((step for step in steps if length / step <= _MAX_DEPTHS), steps[-1])
    first, last = math.ceil(first_m / step - _ROUNDING_PX), math.floor(last_m / step + _ROUNDING_PX)
    return [round(number * step, 6) for number in range(max(first, 1), last + 1)]

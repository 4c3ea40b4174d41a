# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a rig can see: nearest and farthest distance, depth error over the distance, and the search that it takes."""

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

_USUAL_SHARE = 1 / 8  # of the width of the image: disparity of the nearest point where nobody says more
_MIN_DEPTHS, _MAX_DEPTHS = 5, 200  # of a table
_ROUNDING_PX = 1e-6  # a disparity so little beside a whole number is that number


@dataclass(frozen=True)
class Precision:
    """How exact disparities are, and how exact depths shall be.

    Attributes:
        step_px: smallest difference between two disparities that the matcher can tell.
        sigma_px: standard deviation of a disparity.
        max_error: standard deviation of a depth, as a share of it, that is still of use; above 0.

    Raises:
        ConfigError: a value that is not above 0.
    """

    step_px: float
    sigma_px: float
    max_error: float

    def __post_init__(self) -> None:
        for name in ("step_px", "sigma_px", "max_error"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ConfigError(f"{name} = {value:g} is not above 0: without errors every distance is seen")
        if self.max_error > 1:
            raise ConfigError(
                f"an error of {100 * self.max_error:g} % of the depth is asked for, limit 100 %: beyond it a depth "
                "says nothing"
            )


@dataclass(frozen=True)
class DepthRange:
    """Where a rig sees depth, meters along Z of the left rectified camera.

    Attributes:
        baseline_m: distance of the two cameras.
        nearest_m: depth of the largest disparity searched.
        farthest_m: depth beyond which the depth is less exact than asked for.
        search_end_m: depth of the smallest disparity searched; infinite where infinity is searched.
    """

    baseline_m: float
    nearest_m: float
    farthest_m: float
    search_end_m: float


@dataclass(frozen=True)
class DepthError:
    """What a rig tells of a surface at one depth.

    Attributes:
        depth_m: Z in the left rectified camera.
        disparity_px: x_left - x_right.
        step_m: from this depth to that of the next smaller disparity; infinite where that is infinity.
        sigma_m: standard deviation of the depth.
        overlap: share of the left rectified image that the right one shows too, 0..1.
        common_width_m: of what both images show.
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
    """From what depth to what depth a rig sees, or one with so many times its baseline and all else as it is.

    Nearest: Z = f B / (d_max - doffs). Farthest: sigma_Z = Z^2 / (f B) sigma_d reaches the share of Z that is allowed,
    Z = max_error f B / sigma_d.

    Raises:
        ConfigError: nothing that is searched lies in front of the cameras.
    """
    baseline_m = baseline_factor * rig.baseline_m
    f_baseline = rig.f_px * baseline_m
    nearest_px = search.max_disparity - rig.doffs_px
    if nearest_px <= 0:
        raise ConfigError(
            f"the search ends at {search.max_disparity} px, infinity is at {rig.doffs_px:.2f} px with this rig, and "
            "what is nearer has more: raise min_disparity or disparity_range"
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
    """The errors of a rig at these depths, above 0, or of one with so many times its baseline."""
    t = Triangulation.from_rig(rig)
    t = replace(t, baseline_m=baseline_factor * t.baseline_m)
    sigmas_m = depth_sigma(np.array([depths_m], np.float32), t, precision.sigma_px)[0].tolist()
    errors = []
    for depth_m, sigma_m in zip(depths_m, sigmas_m, strict=True):
        parallax_px = t.f_px * t.baseline_m / depth_m  # the disparity less that of infinity
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
    """The smallest search from a distance to infinity that the parameters can express, all else at its default.

    It begins at the disparity of infinity, and one whole disparity is beyond that of the nearest point, so that there
    is a neighbor to interpolate with. disparity_range is a multiple of 16, at least 32.

    Raises:
        ConfigError: the two images have nothing in common at this distance, or a value that the parameters refuse.
    """
    if not 0 < nearest_m < math.inf:
        raise ConfigError(f"nearest distance {nearest_m:g} m is not above 0: give meters")
    nearest_px = rig.f_px * rig.baseline_m / nearest_m + rig.doffs_px
    if nearest_px >= rig.width:
        limit_m = rig.f_px * rig.baseline_m / (rig.width - rig.doffs_px)
        raise ConfigError(
            f"at {nearest_m:g} m the disparity is {nearest_px:.0f} px and the images are {rig.width} px wide: they "
            f"have something in common beyond {limit_m:.3g} m only, take a larger distance or a smaller baseline"
        )
    first = math.floor(rig.doffs_px + _ROUNDING_PX)
    last = math.floor(nearest_px + _ROUNDING_PX) + 1
    count = max(32, 16 * math.ceil((last + 1 - first) / 16))
    return MatchingConfig(min_disparity=first, num_disparities=count)


def default_nearest_m(rig: StereoRig) -> float:
    """The distance, meters, at which the disparity is an eighth of the image's width above that of infinity."""
    return rig.f_px * rig.baseline_m / (_USUAL_SHARE * rig.width)


def rounded_depths_m(first_m: float, last_m: float) -> list[float]:
    """Each whole meter from the first to the last; tenths where those are few, tens where they are many.

    The step is 1, 2 or 5 times a power of ten: 1 m where that makes 5 to 200 depths.
    """
    length = last_m - first_m
    steps = [factor * 10.0**power for power in range(-3, 7) for factor in (1, 2, 5)]
    fine = [step for step in steps if step <= 1 and length / step >= _MIN_DEPTHS]
    step = fine[-1] if fine else steps[0]
    if length / step > _MAX_DEPTHS:
        step = next((step for step in steps if length / step <= _MAX_DEPTHS), steps[-1])
    first, last = math.ceil(first_m / step - _ROUNDING_PX), math.floor(last_m / step + _ROUNDING_PX)
    return [round(number * step, 6) for number in range(max(first, 1), last + 1)]

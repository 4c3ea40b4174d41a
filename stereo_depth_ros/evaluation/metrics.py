# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of disparity and depth against the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import ImageError
from stereo_depth_ros.core.types import F32, F64
from stereo_depth_ros.geometry.robust import robust_sigma

__all__ = ["DepthErrors", "DisparityErrors", "depth_errors", "disparity_errors"]

Mask: TypeAlias = npt.NDArray[np.bool_]
BIAS_PX, BIAS_SPREADS = 0.5, 2.0  # a constant bias is above both, px and spreads of the errors


@dataclass(frozen=True)
class DisparityErrors:
    """Errors over the pixels with truth.

    The thresholds and quantiles are those of the Middlebury tables (Scharstein and Szeliski 2002; Scharstein et al.
    2014), D1 is KITTI's (Menze and Geiger 2015): wrong by more than 3 px and by more than 5 % of the truth.

    Attributes:
        density: share of the pixels with truth that have a disparity, 0..1.
        bad_0_5, bad_1, bad_2, bad_4: percentage of the matched pixels with truth that are wrong by more than 0.5, 1, 2,
            4 px.
        bad_0_5_all, bad_1_all, bad_2_all, bad_4_all: percentage of all pixels with truth that are wrong or have no
            disparity.
        d1, d1_all: the same two of D1.
        avg_px, median_px, rms_px: absolute error of the matched pixels with truth.
        a90_px, a95_px, a99_px: absolute error that 90, 95, 99 percent of them do not exceed (A50 is the median).
        signed_median_px: median of the signed error d - truth of the matched pixels with truth.
        spread_px: how much the signed error scatters about it, 1.4826 times the median absolute deviation, which is the
            standard deviation of a normal distribution and is not changed by outliers.

    A figure over no pixels is NaN.
    """

    density: float
    bad_0_5: float
    bad_1: float
    bad_2: float
    bad_4: float
    bad_0_5_all: float
    bad_1_all: float
    bad_2_all: float
    bad_4_all: float
    d1: float
    d1_all: float
    avg_px: float
    median_px: float
    rms_px: float
    a90_px: float
    a95_px: float
    a99_px: float
    signed_median_px: float
    spread_px: float

    @property
    def constant_bias_px(self) -> float | None:
        """What the disparities are too large by everywhere, px, negative where too small; None where they are not.

        They are biased where the median signed error is above 0.5 px and above twice the spread. Disparities that are
        right up to rounding to whole pixels are within 0.5 px. A median of two standard deviations means that nearly
        all errors have one sign, and that it is not one that grows with the disparity, as of a wrong scale: over
        disparities from 0 on its median is 1.35 spreads. Wrong regions of less than half of the pixels, however large
        their errors, move neither of the two numbers much. Of bm, sgm and sgbm on 12 real scenes (Middlebury 2001 to
        2014, ETH3D) the median is 0.19 px at most, and 0.76 of the spread.
        """
        biased = abs(self.signed_median_px) > max(BIAS_PX, BIAS_SPREADS * self.spread_px)
        return self.signed_median_px if biased else None


@dataclass(frozen=True)
class DepthErrors:
    """Errors over the pixels where depth and truth are both known; NaN over no pixels.

    Attributes:
        density: share of the pixels with truth that have a depth, 0..1.
        median_m: median absolute error, meters.
        median_relative: median of the absolute error divided by the true depth.
    """

    density: float
    median_m: float
    median_relative: float


def disparity_errors(disparity_px: F32, truth_px: F32, mask: Mask | None = None) -> DisparityErrors:
    """Compares disparities with the truth.

    Args:
        disparity_px: float32 (H, W), pixels, NaN where invalid.
        truth_px: float32 (H, W), pixels, not finite where unknown.
        mask: bool (H, W), the pixels to compare; None compares all.

    Raises:
        ImageError: shapes differ.
    """
    known, matched = _pixels(disparity_px, truth_px, mask)
    signed, truth = _signed_error(disparity_px, truth_px, matched), truth_px[matched].astype(np.float64)
    error, signed_median_px = np.abs(signed), _quantile(signed, 0.5)
    count, holes = int(np.count_nonzero(known)), int(np.count_nonzero(known & ~matched))
    wrong = {"bad_0_5": error > 0.5, "bad_1": error > 1, "bad_2": error > 2, "bad_4": error > 4}
    wrong["d1"] = (error > 3) & (error > 0.05 * np.abs(truth))
    counts = {name: int(np.count_nonzero(pixels)) for name, pixels in wrong.items()}
    return DisparityErrors(
        density=_share(error.size, count),
        **{name: 100 * _share(number, error.size) for name, number in counts.items()},
        **{f"{name}_all": 100 * _share(number + holes, count) for name, number in counts.items()},
        avg_px=float(error.mean()) if error.size else float("nan"),
        median_px=_quantile(error, 0.5),
        rms_px=float(np.sqrt(np.mean(error**2))) if error.size else float("nan"),
        a90_px=_quantile(error, 0.9),
        a95_px=_quantile(error, 0.95),
        a99_px=_quantile(error, 0.99),
        signed_median_px=signed_median_px,
        spread_px=robust_sigma(signed - signed_median_px) if signed.size else float("nan"),
    )


def depth_errors(depth_m: F32, truth_m: F32) -> DepthErrors:
    """Compares depths with the truth.

    Args:
        depth_m: float32 (H, W), meters, not finite where invalid.
        truth_m: float32 (H, W), meters, not finite where unknown.

    Raises:
        ImageError: shapes differ.
    """
    known, matched = _pixels(depth_m, truth_m, None)
    error = np.abs(_signed_error(depth_m, truth_m, matched))
    relative = error / truth_m[matched].astype(np.float64)
    return DepthErrors(
        _share(error.size, int(np.count_nonzero(known))), _quantile(error, 0.5), _quantile(relative, 0.5)
    )


def _pixels(values: F32, truth: F32, mask: Mask | None) -> tuple[Mask, Mask]:
    """The pixels with truth, and those of them that have a value."""
    shapes = {values.shape, truth.shape} | (set() if mask is None else {mask.shape})
    if len(shapes) > 1:
        raise ImageError(
            f"result is {values.shape}, truth {truth.shape}{'' if mask is None else f', mask {mask.shape}'}",
            value=values.shape,
            limit=truth.shape,
            remedy="all must have one shape",
        )
    known = np.isfinite(truth) if mask is None else np.isfinite(truth) & mask
    return known, known & np.isfinite(values)


def _signed_error(values: F32, truth: F32, matched: Mask) -> F64:
    error: F64 = values[matched].astype(np.float64) - truth[matched]
    return error


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def _quantile(values: F64, share: float) -> float:
    """Quantile with linear interpolation, so that 0.5 is the median; NaN for no values."""
    return float(np.quantile(values, share)) if values.size else float("nan")

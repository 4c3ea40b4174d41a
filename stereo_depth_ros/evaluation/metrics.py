# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of disparity and depth against the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.errors import ImageError
from stereo_depth_ros.types import F32, F64

__all__ = ["DepthErrors", "DisparityErrors", "depth_errors", "disparity_errors"]


@dataclass(frozen=True)
class DisparityErrors:
    """Errors over the pixels that have a truth (Scharstein and Szeliski 2002; the thresholds of the Middlebury tables).

    Attributes:
        density: share of truth pixels that have a disparity, 0..1.
        bad_0_5, bad_1, bad_2: percent of the matched truth pixels that are wrong by more than 0.5, 1, 2 px.
        bad_2_all: percent of all truth pixels that are wrong by more than 2 px or have no disparity.
        avg_px, median_px, rms_px: absolute error of the matched truth pixels.

    A figure over no pixels is NaN.
    """

    density: float
    bad_0_5: float
    bad_1: float
    bad_2: float
    bad_2_all: float
    avg_px: float
    median_px: float
    rms_px: float


@dataclass(frozen=True)
class DepthErrors:
    """Errors over the pixels where depth and truth are both known; NaN over no pixels.

    Attributes:
        density: share of truth pixels that have a depth, 0..1.
        median_m: median absolute error, metres.
        median_relative: median of absolute error over true depth.
    """

    density: float
    median_m: float
    median_relative: float


def disparity_errors(disparity_px: F32, truth_px: F32, mask: npt.NDArray[np.bool_] | None = None) -> DisparityErrors:
    """Compares disparities with the truth.

    Args:
        disparity_px: float32 (H, W), px, NaN where invalid.
        truth_px: float32 (H, W), px, not finite where unknown.
        mask: bool (H, W), the pixels to look at; None is all.

    Raises:
        ImageError: shapes differ.
    """
    count, error = _errors(disparity_px, truth_px, mask)
    return DisparityErrors(
        density=_share(error.size, count),
        bad_0_5=100 * _share(np.count_nonzero(error > 0.5), error.size),
        bad_1=100 * _share(np.count_nonzero(error > 1), error.size),
        bad_2=100 * _share(np.count_nonzero(error > 2), error.size),
        bad_2_all=100 * _share(np.count_nonzero(error > 2) + count - error.size, count),
        avg_px=float(error.mean()) if error.size else float("nan"),
        median_px=_median(error),
        rms_px=float(np.sqrt(np.mean(error**2))) if error.size else float("nan"),
    )


def depth_errors(depth_m: F32, truth_m: F32) -> DepthErrors:
    """Compares depths with the truth.

    Args:
        depth_m: float32 (H, W), metres, not finite where invalid.
        truth_m: float32 (H, W), metres, not finite where unknown.

    Raises:
        ImageError: shapes differ.
    """
    count, error = _errors(depth_m, truth_m, None)
    truth = truth_m[np.isfinite(truth_m) & np.isfinite(depth_m)].astype(np.float64)
    return DepthErrors(_share(error.size, count), _median(error), _median(error / truth))


def _errors(values: F32, truth: F32, mask: npt.NDArray[np.bool_] | None) -> tuple[int, F64]:
    """Number of pixels with a truth, and absolute errors of those of them that have a value."""
    shapes = {values.shape, truth.shape} | (set() if mask is None else {mask.shape})
    if len(shapes) > 1:
        raise ImageError(
            f"result is {values.shape}, truth {truth.shape}"
            f"{'' if mask is None else f', mask {mask.shape}'}: all must have one shape"
        )
    known = np.isfinite(truth) if mask is None else np.isfinite(truth) & mask
    both = known & np.isfinite(values)
    error: F64 = np.abs(values[both].astype(np.float64) - truth[both])
    return int(np.count_nonzero(known)), error


def _share(part: int | np.integer[Any], whole: int) -> float:
    return float(part / whole) if whole else float("nan")


def _median(values: F64) -> float:
    return float(np.median(values)) if values.size else float("nan")

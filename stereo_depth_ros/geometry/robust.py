# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robust statistics: the standard deviation of values among which there are outliers."""

from __future__ import annotations

import numpy as np

from stereo_depth_ros.core.types import F64

__all__ = ["robust_sigma"]


def robust_sigma(deviations: F64) -> float:
    """Standard deviation of normally distributed deviations, from the median of their absolute values.

    Up to half of them may be outliers (Rousseeuw and Croux 1993, equation 1.3).

    Args:
        deviations: float64 (N,), N at least 1, from their center.
    """
    return 1.4826 * float(np.median(np.abs(deviations)))
